"""GC-Pose on RGB-D video."""

from __future__ import annotations

from .pipeline import depth_video, estimate_rgbd
from .settings import RgbdSettings

__all__ = ["RgbdSettings", "depth_video", "estimate_rgbd"]
