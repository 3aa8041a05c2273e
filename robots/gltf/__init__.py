"""Reader of glTF files with skins, morph targets and animations."""

from __future__ import annotations

from .reader import load_gltf

__all__ = ["load_gltf"]
