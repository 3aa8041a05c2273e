"""GC-Pose on a video file: which frames are read, and what is written of the estimate."""

from __future__ import annotations

from .frames import Region, VideoFrames, read_frames
from .observation import check_distance, find_axes, find_field_of_view, observe_video
from .report import (
    check_outputs,
    describe_joints,
    doubt_still_texture,
    draw_parts,
    summarize_estimate,
    towards_camera,
    write_table,
)

__all__ = [
    "Region",
    "VideoFrames",
    "check_distance",
    "check_outputs",
    "describe_joints",
    "doubt_still_texture",
    "draw_parts",
    "find_axes",
    "find_field_of_view",
    "observe_video",
    "read_frames",
    "summarize_estimate",
    "towards_camera",
    "write_table",
]
