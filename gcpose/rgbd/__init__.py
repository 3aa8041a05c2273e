"""GC-Pose on RGB-D video."""

from __future__ import annotations

from .bundle import Views, adjust, deviation
from .labels import lively
from .search import lost, search
from .settings import RgbdSettings
from .tracker import Tracker

__all__ = ["RgbdSettings", "Tracker", "Views", "adjust", "deviation", "lively", "lost", "search"]
