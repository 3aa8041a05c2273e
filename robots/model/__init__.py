"""Articulated models: the tree of parts, joints, surfaces, textures and skins."""

from __future__ import annotations

from .articulated_model import (
    Animation,
    ArticulatedModel,
    ModelState,
    forward_kinematics,
    joint_screws,
    rest_size,
    scale_model,
)
from .links import Joint, JointType, Link, Mimic, list_names
from .skinning import deform_visual
from .surface import TriangleSurface, clean_surface, clean_triangles, move_surface, visuals_of_part
from .texture import TextureDecoder, base_color, mean_color
from .visuals import INVISIBLE, Maps, Material, Morph, Skin, Tiling, Visual

__all__ = [
    "INVISIBLE", "Animation", "ArticulatedModel", "Joint", "JointType", "Link", "Maps", "Material",
    "Mimic", "ModelState", "Morph", "Skin", "TextureDecoder", "Tiling", "TriangleSurface", "Visual",
    "base_color", "clean_surface", "clean_triangles", "deform_visual", "forward_kinematics",
    "joint_screws", "list_names", "mean_color", "move_surface", "rest_size", "scale_model",
    "visuals_of_part",
]
