"""GC-Pose on RGB-D video."""

from __future__ import annotations

from .evidence import DepthHypothesis, Labeling, RgbdEvidence
from .labels import Clouds
from .pipeline import DepthVideo, depth_video, estimate_rgbd, label_frames, search_depth
from .residuals import SurfaceResiduals
from .search import is_static, is_unreliable
from .settings import RgbdSettings

__all__ = [
    "Clouds", "DepthHypothesis", "DepthVideo", "Labeling", "RgbdEvidence", "RgbdSettings",
    "SurfaceResiduals", "depth_video", "estimate_rgbd", "is_static", "is_unreliable",
    "label_frames", "search_depth",
]
