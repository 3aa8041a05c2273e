"""Reader of STL, OBJ and PLY meshes with trimesh, with checked sizes and references."""

# trimesh has no complete types
# pyright: reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportUnknownArgumentType=false, reportUnknownParameterType=false

from __future__ import annotations

import io
from typing import Any

import numpy as np

from ...errors import ModelError
from ..files import MATERIALS, TEXTURES, Asset
from ..model import (
    Material,
    TextureDecoder,
    TriangleSurface,
    base_color,
    clean_surface,
    mean_color,
    move_surface,
)
from .asset_reader import AssetReader, last_part


def read_with_trimesh(
    data: bytes, kind: str, asset: Asset, reader: AssetReader
) -> list[TriangleSurface]:
    """Return all triangles of a file of `kind`; raise ModelError, or any error of trimesh."""
    import trimesh

    if kind == "obj" and b"\x00" in data[:1000]:
        raise ModelError("is not an OBJ file: it holds binary data")
    scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False,
                               resolver=_resolver(asset, reader))
    nodes: list[tuple[Any, Any]] = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            nodes.append((matrix, mesh))
    triangles = sum(len(mesh.faces) for _, mesh in nodes)
    limits = reader.limits
    if len(nodes) > limits.instances or triangles > limits.triangles:
        raise ModelError(f"has more than {limits.triangles} triangles or {limits.instances} parts")
    materials: dict[int, Material | None] = {}
    found: list[TriangleSurface] = []
    for matrix, mesh in nodes:
        key = id(getattr(mesh.visual, "material", None))
        if key not in materials or mesh.visual.kind != "texture":
            materials[key] = _material(mesh, asset.path.name, reader.textures)
        made = clean_surface(
            mesh.vertices, mesh.faces,
            # reading `vertex_normals` may compute them; only those of the file are used
            mesh.vertex_normals if "vertex_normals" in mesh._cache else None, # pyright: ignore[reportPrivateUsage]
            getattr(mesh.visual, "uv", None), materials[key],
            _vertex_color(mesh, asset, reader))
        if made is not None:
            found.append(made if np.array_equal(matrix, np.eye(4)) else move_surface(made, matrix))
    return found


def _material(mesh: Any, file: str, textures: TextureDecoder) -> Material | None:
    """Convert a trimesh material; return None if the file names none."""
    from trimesh.visual.material import SimpleMaterial

    given = getattr(mesh.visual, "material", None)
    if not isinstance(given, SimpleMaterial):
        return None
    # Pillow has opened the image of a file, but not decoded it. For texture coordinates without a
    # material, trimesh invents one with an image of no file.
    image = getattr(given.image, "fp", None)
    if given.image is not None and image is None:
        return None
    if given.name or image is not None or "kd" in given.kwargs:
        extra = given.kwargs
        color = np.resize(np.asarray(extra.get("kd", 0.5), np.float64).reshape(-1), 3)
        if not np.isfinite(color).all():
            color = np.full(3, 0.5)
        if image is not None:
            color = np.ones(3)  # Kd beside map_Kd is arbitrary; only the map is used
        alpha = _alpha_of_mtl(extra)
        texture = None
        if image is not None:
            texture = textures.decode(image.getvalue(), f"{file}: its texture")
        return Material(str(given.name or ""), base_color([*color, alpha]), texture=texture)
    return None


def _alpha_of_mtl(extra: dict[str, Any]) -> float:
    try:
        alpha = float(extra["d"][-1]) if "d" in extra else 1.0 - float(extra.get("tr", ["0"])[-1])
    except (ValueError, IndexError):
        return 1.0
    # `d 0` or `Tr 1` for a whole mesh comes from exporters that invert the meaning
    return alpha if 0.0 < alpha <= 1.0 else 1.0


def _vertex_color(
    mesh: Any, asset: Asset, reader: AssetReader
) -> tuple[float, float, float, float] | None:
    kind = getattr(mesh.visual, "kind", None)
    if kind not in ("vertex", "face"):
        return None
    colors = mesh.visual.vertex_colors if kind == "vertex" else mesh.visual.face_colors
    if np.ptp(colors, axis=0).any():
        reader.note(f"{asset.path.name}: colors of vertices or faces become one, their mean")
    return mean_color(np.asarray(colors, np.uint8)[:, None, :])


def _resolver(asset: Asset, reader: AssetReader) -> Any:
    from trimesh.resolvers import Resolver

    class OurResolver(Resolver):
        """Resolver of the references of a mesh that accepts only checked files."""

        def __init__(self) -> None:
            self.file_name = asset.path.name

        def get(self, key: str) -> bytes:
            name = str(key).strip()
            try:
                return reader.read(reader.finder.find_beside(asset, name, MATERIALS | TEXTURES))
            except ModelError as error:
                reader.note_failure(asset, f"file {last_part(name)!r}", error)
                raise FileNotFoundError(last_part(name)) from error

        def write(self, name: str, data: Any) -> None:
            raise NotImplementedError

        def namespaced(self, namespace: str) -> Any:
            return self

        def keys(self) -> list[str]:
            return []

    return OurResolver()
