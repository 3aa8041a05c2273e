"""Transforms, screws, camera, depth images and normals: the one geometry of the project."""

from __future__ import annotations

from . import pinhole, se3
from .depth_images import DEPTH_HEIGHT, fit_depth, fit_intrinsics
from .hulls import hull_vertices
from .normals import face_normals, smooth_corners, valid_normals
from .se3 import move_screw, prismatic_motion, revolute_motion
from .transforms import (
    Array,
    apply,
    inverse,
    nearest_rotation,
    quaternion_from_rotation,
    rotation_about,
    rotation_from_quaternion,
    rotation_from_rpy,
    transform,
)

__all__ = [
    "DEPTH_HEIGHT", "Array", "apply", "face_normals", "fit_depth", "fit_intrinsics",
    "hull_vertices", "inverse", "move_screw", "nearest_rotation", "pinhole",
    "prismatic_motion", "quaternion_from_rotation", "revolute_motion", "rotation_about",
    "rotation_from_quaternion", "rotation_from_rpy", "se3", "smooth_corners",
    "transform", "valid_normals",
]
