"""The records that methods and metrics see: cameras, sequences, observations, estimates."""

from __future__ import annotations

from .camera import Camera, intrinsics_from_fov, look_at
from .cards import html_card
from .observation import Estimate, Inputs, Knowledge, Method, Observation
from .sequence import (
    BACKGROUND,
    FORMAT,
    MAX_PIXELS,
    OCCLUDED,
    OUT_OF_IMAGE,
    VISIBLE,
    Frame,
    Meta,
    Sequence,
    Stack,
    State,
    describe_absence,
)

__all__ = [
    "BACKGROUND", "FORMAT", "MAX_PIXELS", "OCCLUDED", "OUT_OF_IMAGE", "VISIBLE", "Camera",
    "Estimate", "Frame", "Inputs", "Knowledge", "Meta", "Method", "Observation", "Sequence",
    "Stack", "State", "describe_absence", "html_card", "intrinsics_from_fov", "look_at",
]
