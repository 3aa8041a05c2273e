"""Mesh files and solids as surfaces in metres."""

from __future__ import annotations

from .asset_reader import MeshLimits, quiet
from .library import MeshLibrary
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

__all__ = [
    "MeshLibrary", "MeshLimits", "bar", "block", "box", "capsule", "circle", "cylinder", "hull",
    "join_surfaces", "plate", "quiet", "revolve", "rod", "round_corners", "sphere",
]
