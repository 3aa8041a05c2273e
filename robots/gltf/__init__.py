"""Reader of glTF files: as models with skins, morph targets and animations, and as meshes."""

from __future__ import annotations

from .mesh_file import read_gltf_surfaces
from .reader import load_gltf

__all__ = ["load_gltf", "read_gltf_surfaces"]
