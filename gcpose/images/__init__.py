"""What images say: flow, depth, surfaces, patches, regions."""

from __future__ import annotations

from .denoise import smoothed
from .depth import Depth, depth_named
from .flow import dis_flow, fine_dis_flow, flow_named, for_cuts_of, training_of
from .flow_types import Flow
from .patches import match
from .regions import Candidates, order_from_base, smooth
from .still_camera import CONTRAST, Footage, footage
from .surfaces import Surfaces, measure, rays

__all__ = [
    "CONTRAST", "Candidates", "Depth", "Flow", "Footage", "Surfaces", "depth_named",
    "dis_flow", "fine_dis_flow", "flow_named", "footage", "for_cuts_of", "match", "measure",
    "order_from_base", "rays", "smooth", "smoothed", "training_of",
]
