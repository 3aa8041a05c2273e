"""Mesh files and solids as surfaces in metres."""

from __future__ import annotations

from .library import MAX_INSTANCES, MAX_TRIANGLES, MeshLibrary, quiet
from .primitives import box, capsule, cylinder, joined, revolved, sphere
from .solids import bar, block, circle, hull, plate, rod, rounded

__all__ = [
    "MAX_INSTANCES", "MAX_TRIANGLES", "MeshLibrary", "bar", "block", "box", "capsule", "circle",
    "cylinder", "hull", "joined", "plate", "quiet", "revolved", "rod", "rounded", "sphere",
]
