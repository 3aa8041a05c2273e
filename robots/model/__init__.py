"""What an articulated model is: its tree of parts, joints, surfaces, textures and skins."""

from __future__ import annotations

from .articulated_model import (
    FIXED,
    PRISMATIC,
    REVOLUTE,
    Animation,
    ArticulatedModel,
    Maps,
    Material,
    ModelState,
    Morph,
    Skin,
    Tiling,
    Visual,
    forward_kinematics,
    joint_screws,
)
from .kinematic_tree import parts_in_order, resolve_mimics
from .skinning import deformed
from .surface import TriangleSurface, clean_triangles, moved, surface, visuals_of_part
from .texture import base_color, decode_texture, mean_color, texture_from_image

__all__ = [
    "FIXED",
    "PRISMATIC",
    "REVOLUTE",
    "Animation",
    "ArticulatedModel",
    "Maps",
    "Material",
    "ModelState",
    "Morph",
    "Skin",
    "Tiling",
    "TriangleSurface",
    "Visual",
    "base_color",
    "clean_triangles",
    "decode_texture",
    "deformed",
    "forward_kinematics",
    "joint_screws",
    "mean_color",
    "moved",
    "parts_in_order",
    "resolve_mimics",
    "surface",
    "texture_from_image",
    "visuals_of_part",
]
