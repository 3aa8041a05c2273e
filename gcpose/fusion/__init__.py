"""GC-Pose by noisy depth and images at once."""

from __future__ import annotations

from .pipeline import estimate_by_fusion
from .settings import FusionSettings

__all__ = ["FusionSettings", "estimate_by_fusion"]
