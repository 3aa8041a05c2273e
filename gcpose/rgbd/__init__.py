"""GC-Pose on RGB-D video."""

from __future__ import annotations

from .bundle import Views, adjust, standard_deviations
from .labels import moving_mask
from .search import is_unreliable, search_hypotheses
from .settings import RgbdSettings
from .tracker import Tracker

__all__ = [
    "RgbdSettings", "Tracker", "Views", "adjust", "is_unreliable", "moving_mask",
    "search_hypotheses", "standard_deviations",
]
