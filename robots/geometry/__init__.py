"""Transforms, rotations and normals: the one geometry of the project."""

from __future__ import annotations

from .normals import face_normals, smooth_corners, valid_normals
from .transforms import (
    Array,
    apply,
    inverse,
    move_screw,
    prismatic_motion,
    revolute_motion,
    rotation_about,
    transform,
)

__all__ = [
    "Array", "apply", "face_normals", "inverse", "move_screw", "prismatic_motion",
    "revolute_motion", "rotation_about", "smooth_corners", "transform", "valid_normals",
]
