"""GC-Pose on RGB-D video."""

from __future__ import annotations

from .pipeline import estimate_rgbd
from .settings import RgbdSettings

__all__ = ["RgbdSettings", "estimate_rgbd"]
