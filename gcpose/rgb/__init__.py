"""GC-Pose on plain video."""

from __future__ import annotations

from .evidence import observed
from .labels import Spots
from .pipeline import estimate_rgb
from .points import Rays
from .strategies import ends
from .tracker import Guess, RayTracker

__all__ = ["Guess", "RayTracker", "Rays", "Spots", "ends", "estimate_rgb", "observed"]
