"""Measurements of images: flow, depth, foreground, texture, patches, surfaces, neighborhoods.

`network_flow` needs PyTorch and is imported on use.
"""

from __future__ import annotations

from .depth import Depth, depth_named
from .flow import (
    Flow,
    dis_flow,
    fine_dis_flow,
    flow_named,
    for_cuts_of,
    row_suffix,
    training_of,
)
from .patches import PredictedPatches, find_patches
from .regions import Candidates, geodesic_rank, smooth_costs
from .settings import ImageSettings
from .still_camera import VideoEvidence, video_evidence
from .surfaces import Surfaces, surfaces_from_depth, surfaces_from_noisy_depth

__all__ = [
    "Candidates", "Depth", "Flow", "ImageSettings", "PredictedPatches", "Surfaces",
    "VideoEvidence", "depth_named", "dis_flow", "find_patches", "fine_dis_flow", "flow_named",
    "for_cuts_of", "geodesic_rank", "row_suffix", "smooth_costs", "surfaces_from_depth",
    "surfaces_from_noisy_depth", "training_of", "video_evidence",
]
