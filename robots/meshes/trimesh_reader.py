"""Reader of STL, OBJ, PLY and glTF meshes with trimesh, with checked sizes and references."""

# trimesh has no complete types
# pyright: reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportUnknownArgumentType=false, reportUnknownParameterType=false

from __future__ import annotations

import io
import json
import struct
from typing import Any

import numpy as np

from ...errors import ModelError
from ..files import BUFFERS, MATERIALS, TEXTURES, Asset, MissingAssetError
from ..model import (
    Material,
    TriangleSurface,
    base_color,
    clean_surface,
    mean_color,
    move_surface,
    texture_from_image,
)
from .asset_reader import AssetReader, MeshLimits, last_part

GLTF_EXTENSIONS = frozenset({
    "KHR_materials_unlit", "KHR_materials_emissive_strength", "KHR_materials_ior",
    "KHR_materials_specular", "KHR_materials_clearcoat", "KHR_materials_sheen",
    "KHR_materials_pbrSpecularGlossiness", "KHR_lights_punctual",
})
"""Required extensions that do not affect flat materials and are ignored."""


def read_with_trimesh(
    data: bytes, kind: str, asset: Asset, reader: AssetReader
) -> list[TriangleSurface]:
    """Return all triangles of a file of `kind`; raise ModelError, or any error of trimesh."""
    import trimesh

    if kind in ("glb", "gltf"):
        _check_gltf(data, kind, reader.limits)
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
            materials[key] = _material(mesh, asset.path.name)
        made = clean_surface(
            mesh.vertices, mesh.faces,
            # reading `vertex_normals` may compute them; only those of the file are used
            mesh.vertex_normals if "vertex_normals" in mesh._cache else None, # pyright: ignore[reportPrivateUsage]
            getattr(mesh.visual, "uv", None), materials[key], _vertex_color(mesh))
        if made is not None:
            found.append(made if np.array_equal(matrix, np.eye(4)) else move_surface(made, matrix))
    return found


def _material(mesh: Any, file: str) -> Material | None:
    """Convert a trimesh material; return None if the file names none."""
    from trimesh.visual.material import PBRMaterial, SimpleMaterial

    given = getattr(mesh.visual, "material", None)
    if isinstance(given, PBRMaterial):
        color = given.baseColorFactor
        rgba = np.ones(4) if color is None else np.asarray(color, np.float64) / 255.0
        r, g, b, a = np.clip(rgba, 0.0, 1.0).tolist()
        if given.alphaMode in (None, "OPAQUE"):
            a = 1.0
        image = given.baseColorTexture
        return Material(
            str(given.name or ""), (r, g, b, a),
            1.0 if given.metallicFactor is None else float(np.clip(given.metallicFactor, 0, 1)),
            1.0 if given.roughnessFactor is None else float(np.clip(given.roughnessFactor, 0, 1)),
            None if image is None else texture_from_image(image, f"{file}: texture"))
    if isinstance(given, SimpleMaterial) and (given.name or given.image is not None
                                              or "kd" in given.kwargs):
        extra = given.kwargs
        color = np.asarray(extra.get("kd", [0.5, 0.5, 0.5]), np.float64).reshape(-1)
        color = np.resize(color, 3)
        if given.image is not None:
            color = np.ones(3)  # Kd beside map_Kd is arbitrary; only the map is used
        alpha = _alpha_of_mtl(extra)
        return Material(str(given.name or ""), base_color([*color, alpha]), texture=None
                        if given.image is None else texture_from_image(given.image, file))
    return None


def _alpha_of_mtl(extra: dict[str, Any]) -> float:
    try:
        alpha = float(extra["d"][-1]) if "d" in extra else 1.0 - float(extra.get("tr", ["0"])[-1])
    except (ValueError, IndexError):
        return 1.0
    # `d 0` or `Tr 1` for a whole mesh comes from exporters that invert the meaning
    return alpha if 0.0 < alpha <= 1.0 else 1.0


def _vertex_color(mesh: Any) -> tuple[float, float, float, float] | None:
    kind = getattr(mesh.visual, "kind", None)
    if kind not in ("vertex", "face"):
        return None
    colors = mesh.visual.vertex_colors if kind == "vertex" else mesh.visual.face_colors
    return mean_color(np.asarray(colors, np.uint8)[:, None, :])


def _resolver(asset: Asset, reader: AssetReader) -> Any:
    from trimesh.resolvers import Resolver

    class OurResolver(Resolver):
        """Resolver of the references of a mesh that accepts only checked files."""

        def __init__(self) -> None:
            self.file_name = asset.path.name

        def get(self, key: str) -> bytes:
            name = str(key).strip()
            suffixes = MATERIALS | TEXTURES | BUFFERS
            try:
                return reader.read(reader.finder.nested(asset, name, suffixes))
            except ModelError as error:
                if asset.path.suffix.lower() == ".gltf" and not isinstance(
                        error, MissingAssetError):
                    raise
                reader.note_failure(asset, f"file {last_part(name)!r}", error)
                raise FileNotFoundError(last_part(name)) from error

        def write(self, name: str, data: Any) -> None:
            raise NotImplementedError

        def namespaced(self, namespace: str) -> Any:
            return self

        def keys(self) -> list[str]:
            return []

    return OurResolver()


def _check_gltf(data: bytes, kind: str, limits: MeshLimits) -> None:
    """Refuse features that trimesh misreads, and sizes above the limits."""
    text = data
    if kind == "glb":
        if data[:4] != b"glTF" or len(data) < 20:
            raise ModelError("is not a GLB file: its first bytes are not 'glTF'")
        (length,) = struct.unpack_from("<I", data, 12)
        text = data[20:20 + length]
    header = json.loads(text)
    if not isinstance(header, dict):
        raise ModelError("is not a glTF file: its JSON is not an object")
    if str(header.get("asset", {}).get("version", "2")).split(".")[0] != "2":
        raise ModelError("is glTF of another version; export it as glTF 2.0")
    unknown = sorted(set(map(str, header.get("extensionsRequired", []))) - GLTF_EXTENSIONS)
    if unknown:
        raise ModelError(f"requires the glTF extension {', '.join(unknown)}, which is not "
                         "supported; export it without compression")
    counts = [a.get("count", 0) for a in header.get("accessors", [])]
    largest = 20 * limits.triangles
    if any(not isinstance(c, int) or c < 0 for c in counts) or sum(counts) > largest:
        raise ModelError("has accessors of impossible size")
    for buffer in header.get("buffers", []):
        uri = str(buffer.get("uri", ""))
        if not uri.startswith("data:") and (".." in uri.split("/") or ":" in uri
                                            or uri.startswith("/")):
            raise ModelError(f"refers to the buffer {uri[:60]!r}; it must lie beside the file")
