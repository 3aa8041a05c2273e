"""GC-Pose on a video file: which frames are read, and what is written of the estimate."""

from __future__ import annotations

from .frames import Region, VideoFrames, read_frames
from .observation import check_joints, find_axes, find_field_of_view, observe_video
from .reliability import check_motion, doubt_still_texture, explain_doubts
from .report import (
    check_outputs,
    describe_joints,
    draw_parts,
    name_outputs,
    summarize_estimate,
    towards_camera,
    write_table,
)

__all__ = [
    "Region",
    "VideoFrames",
    "check_joints",
    "check_motion",
    "check_outputs",
    "describe_joints",
    "doubt_still_texture",
    "draw_parts",
    "explain_doubts",
    "find_axes",
    "find_field_of_view",
    "name_outputs",
    "observe_video",
    "read_frames",
    "summarize_estimate",
    "towards_camera",
    "write_table",
]
