"""GC-Pose on plain video: motion of a chain from images without depth, up to scale."""

from __future__ import annotations

from .bundle import BundleWeights
from .labels import SampledPixels
from .pipeline import estimate_rgb
from .points import InverseDepthPoints, measure_flow
from .settings import RgbSettings
from .strategies import base_candidates
from .tracker import VideoHypothesis, VideoTracker

__all__ = [
    "BundleWeights", "InverseDepthPoints", "RgbSettings", "SampledPixels", "VideoHypothesis",
    "VideoTracker", "base_candidates", "estimate_rgb", "measure_flow",
]
