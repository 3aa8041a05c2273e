"""GC-Pose on plain video: motion of a chain from images without depth, up to scale."""

from __future__ import annotations

from .evidence import RgbEvidence, VideoAdjustment, VideoHypothesis
from .focal_length import find_focal_length
from .labels import SampledPixels
from .pipeline import estimate_rgb, has_square_pixels, see_video
from .points import InverseDepthPoints
from .residuals import RayResiduals
from .search import base_candidates, search_video, start_points
from .settings import RgbSettings

__all__ = [
    "InverseDepthPoints", "RayResiduals", "RgbEvidence", "RgbSettings", "SampledPixels",
    "VideoAdjustment", "VideoHypothesis", "base_candidates", "estimate_rgb", "find_focal_length",
    "has_square_pixels", "search_video", "see_video", "start_points",
]
