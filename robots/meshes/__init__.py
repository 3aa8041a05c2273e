"""Mesh files and solids as surfaces in metres."""

from __future__ import annotations

from .asset_reader import AssetReader, MeshLimits, file_errors
from .collada import read_collada
from .solids import (
    bar,
    block,
    box,
    capsule,
    circle,
    cylinder,
    hull,
    join_surfaces,
    plate,
    revolve,
    rod,
    round_corners,
    sphere,
)
from .trimesh_reader import read_with_trimesh

__all__ = [
    "AssetReader", "MeshLimits", "bar", "block", "box", "capsule", "circle", "cylinder",
    "file_errors", "hull", "join_surfaces", "plate", "read_collada", "read_with_trimesh", "revolve",
    "rod", "round_corners", "sphere",
]
