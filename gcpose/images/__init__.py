"""Measurements of images: flow, depth, foreground, texture, patches, surfaces, neighborhoods.

`network_flow` needs PyTorch and is imported on use.
"""

from __future__ import annotations

from .camera_motion import find_camera_motion
from .convolution import WeightReader
from .depth import Depth, find_depth
from .flow import (
    Flow,
    FlowPair,
    dis_flow,
    find_flow,
    fine_dis_flow,
    for_cuts_of,
    row_suffix,
    training_of,
)
from .foreground import (
    Foreground,
    LearnedForeground,
    find_foreground,
    find_people,
    subtract_background,
)
from .foreground_input import (
    FOREGROUND_CHANNELS,
    Square,
    changing_square,
    color_and_change,
    cut_square,
)
from .foreground_network import ForegroundInference
from .patches import PredictedPatches, find_patches
from .regions import Candidates, geodesic_rank, smooth_costs
from .settings import ImageSettings
from .still_camera import FrontEnd, VideoEvidence, video_evidence
from .still_texture import still_texture_share
from .still_video import to_still_video
from .straight_edges import moving_edges, still_edges
from .surfaces import Surfaces, surfaces_from_depth, surfaces_from_noisy_depth

__all__ = [
    "FOREGROUND_CHANNELS", "Candidates", "Depth", "Flow", "FlowPair", "Foreground",
    "ForegroundInference", "FrontEnd", "ImageSettings", "LearnedForeground", "PredictedPatches",
    "Square", "Surfaces", "VideoEvidence", "WeightReader", "changing_square", "color_and_change",
    "cut_square", "dis_flow", "find_camera_motion", "find_depth", "find_flow", "find_foreground",
    "find_patches", "find_people", "fine_dis_flow", "for_cuts_of", "geodesic_rank",
    "moving_edges", "row_suffix", "smooth_costs", "still_edges", "still_texture_share",
    "subtract_background", "surfaces_from_depth", "surfaces_from_noisy_depth", "to_still_video",
    "training_of", "video_evidence",
]
