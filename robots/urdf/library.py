"""Reader of mesh files (STL, OBJ, DAE, PLY, glTF) of untrusted models; surfaces in metres."""

from __future__ import annotations

from pathlib import Path

from ...errors import ModelError
from ..files import Asset, AssetFinder
from ..gltf import read_gltf_surfaces
from ..meshes import AssetReader, MeshLimits, file_errors, read_collada, read_with_trimesh
from ..model import TriangleSurface


class MeshLibrary(AssetReader):
    """Cached reader of the mesh files of one model."""

    def __init__(self, finder: AssetFinder, limits: MeshLimits | None = None) -> None:
        super().__init__(finder, limits)
        self._surfaces: dict[Path, tuple[TriangleSurface, ...]] = {}

    def surfaces(self, reference: str) -> tuple[TriangleSurface, ...]:
        """Return the surfaces of the mesh file at a URDF `reference`.

        Raises:
            ModelError: If the file is missing, cannot be read or holds no triangles.
        """
        asset = self.finder.find(reference)
        if asset.path not in self._surfaces:
            self._surfaces[asset.path] = self._load(asset)
        return self._surfaces[asset.path]

    def _load(self, asset: Asset) -> tuple[TriangleSurface, ...]:
        data = self.read(asset)
        suffix = asset.path.suffix.lower()
        if not data.strip():
            raise ModelError(f"{asset.path}: is empty")
        if data.startswith(b"version https://git-lfs"):
            raise ModelError(f"{asset.path}: is a Git LFS pointer; run `git lfs pull` there first")
        with file_errors(asset.path, suffix[1:].upper()):
            if suffix == ".dae":
                found = read_collada(data, asset, self)
            elif suffix in (".glb", ".gltf"):
                found = read_gltf_surfaces(data, asset, self)
            else:
                found = read_with_trimesh(data, suffix[1:], asset, self)
        if not found:
            raise ModelError(f"{asset.path}: holds no triangles, or ends early")
        return tuple(found)
