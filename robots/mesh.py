"""Mesh files (STL, OBJ, DAE, PLY, glTF) of untrusted models, as surfaces in metres."""

# trimesh has no complete types
# pyright: reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportUnknownArgumentType=false, reportUnknownParameterType=false

from __future__ import annotations

import io
import json
import logging
import struct
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .model import Material, ModelError
from .references import BUFFERS, MATERIALS, TEXTURES, Asset, AssetFinder, MissingAssetError
from .references import read_file as read_bytes
from .surface import Surface, moved, surface
from .texture import base_color, decode_texture, mean_color, texture_from_image

MAX_TRIANGLES = 5_000_000
MAX_TOTAL_BYTES = 2**30
MAX_INSTANCES = 20_000
GLTF_EXTENSIONS = frozenset({
    "KHR_materials_unlit", "KHR_materials_emissive_strength", "KHR_materials_ior",
    "KHR_materials_specular", "KHR_materials_clearcoat", "KHR_materials_sheen",
    "KHR_materials_pbrSpecularGlossiness", "KHR_lights_punctual",
})
"""Required extensions that a picture of flat materials can do without."""


class MeshLibrary:
    """Reads each mesh file of one model once; `notes` says what could not be had."""

    def __init__(self, finder: AssetFinder) -> None:
        self.finder = finder
        self.notes: dict[str, None] = {}
        self._surfaces: dict[Path, tuple[Surface, ...]] = {}
        self._textures: dict[Path, NDArray[np.uint8]] = {}
        self._bytes = 0

    def surfaces(self, reference: str) -> tuple[Surface, ...]:
        """The surfaces of the mesh that a URDF means by `reference`; raises ModelError."""
        asset = self.finder.find(reference)
        if asset.path not in self._surfaces:
            self._surfaces[asset.path] = self._load(asset)
        return self._surfaces[asset.path]

    def texture(self, reference: str) -> NDArray[np.uint8]:
        """The texture [h w 3|4] that a URDF means by `reference`; raises ModelError."""
        return self._decoded(self.finder.find(reference, TEXTURES))

    def nested_texture(self, asset: Asset, reference: str) -> NDArray[np.uint8] | None:
        """The texture that a mesh file means; one that cannot be had is noted, and None."""
        try:
            return self._decoded(self.finder.nested(asset, reference, TEXTURES))
        except ModelError as error:
            reason = "is missing" if isinstance(error, MissingAssetError) else "cannot be used"
            self.note(f"{asset.path.name}: texture {_last(reference)!r} {reason}")
            return None

    def note(self, text: str) -> None:
        self.notes[text] = None

    def read(self, asset: Asset) -> bytes:
        data = read_bytes(asset.path)
        self._bytes += len(data)
        if self._bytes > MAX_TOTAL_BYTES:
            raise ModelError(f"{asset.path}: the model's files exceed {MAX_TOTAL_BYTES} bytes")
        return data

    def _decoded(self, asset: Asset) -> NDArray[np.uint8]:
        if asset.path not in self._textures:
            self._textures[asset.path] = decode_texture(self.read(asset), str(asset.path))
        return self._textures[asset.path]

    def _load(self, asset: Asset) -> tuple[Surface, ...]:
        data = self.read(asset)
        kind = asset.path.suffix.lower()
        if not data.strip():
            raise ModelError(f"{asset.path}: is empty")
        if data.startswith(b"version https://git-lfs"):
            raise ModelError(f"{asset.path}: is a Git LFS pointer; run `git lfs pull` there first")
        try:
            with quiet():
                if kind == ".dae":
                    from .dae import surfaces_of_dae

                    found = surfaces_of_dae(data, asset, self)
                else:
                    found = _surfaces_of_trimesh(data, kind[1:], asset, self)
        except ModelError as error:
            raise ModelError(_named(asset.path, str(error))) from error
        except (Exception, RecursionError) as error:
            why = " ".join(str(error).split())[:200] or type(error).__name__
            raise ModelError(f"{asset.path}: is not a {kind} file that can be read ({why})"
                             ) from error
        if not found:
            raise ModelError(f"{asset.path}: holds no triangles")
        return tuple(found)


@contextmanager
def quiet() -> Generator[None]:
    """Without the warnings and log lines of mesh libraries: what matters is an error or a note."""
    loggers = [logging.getLogger(name) for name in ("trimesh", "yourdfpy.urdf", "collada")]
    before = [logger.disabled for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for logger in loggers:
                logger.disabled = True
            with np.errstate(all="ignore"):
                yield
        finally:
            for logger, disabled in zip(loggers, before, strict=True):
                logger.disabled = disabled


def _surfaces_of_trimesh(
    data: bytes, kind: str, asset: Asset, library: MeshLibrary
) -> list[Surface]:
    import trimesh

    if kind in ("glb", "gltf"):
        _check_gltf(data, kind)
    if kind == "obj" and b"\x00" in data[:1000]:
        raise ModelError("is not an OBJ file: it holds binary data")
    scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False,
                               resolver=_resolver(asset, library))
    nodes: list[tuple[Any, Any]] = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            nodes.append((matrix, mesh))
    if len(nodes) > MAX_INSTANCES or sum(len(m.faces) for _, m in nodes) > MAX_TRIANGLES:
        raise ModelError(f"has more than {MAX_TRIANGLES} triangles or {MAX_INSTANCES} parts")
    materials: dict[int, Material | None] = {}
    found: list[Surface] = []
    for matrix, mesh in nodes:
        key = id(getattr(mesh.visual, "material", None))
        if key not in materials or mesh.visual.kind != "texture":
            materials[key] = _material(mesh, asset.path.name)
        made = surface(
            mesh.vertices, mesh.faces,
            # asking a mesh for normals makes them; only those of the file are wanted
            mesh.vertex_normals if "vertex_normals" in mesh._cache else None, # pyright: ignore[reportPrivateUsage]
            getattr(mesh.visual, "uv", None), materials[key], _vertex_color(mesh))
        if made is not None:
            found.append(made if np.array_equal(matrix, np.eye(4)) else moved(made, matrix))
    return found


def _material(mesh: Any, file: str) -> Material | None:
    """Our material of a trimesh one; None where the file names none."""
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
            color = np.ones(3)  # exporters write any Kd beside map_Kd; what is seen is the map
        alpha = _alpha_of_mtl(extra)
        return Material(str(given.name or ""), base_color([*color, alpha]), texture=None
                        if given.image is None else texture_from_image(given.image, file))
    return None


def _alpha_of_mtl(extra: dict[str, Any]) -> float:
    try:
        alpha = float(extra["d"][-1]) if "d" in extra else 1.0 - float(extra.get("tr", ["0"])[-1])
    except (ValueError, IndexError):
        return 1.0
    # `d 0` or `Tr 1` for a whole mesh is an exporter that reads the letter the other way round
    return alpha if 0.0 < alpha <= 1.0 else 1.0


def _vertex_color(mesh: Any) -> tuple[float, float, float, float] | None:
    kind = getattr(mesh.visual, "kind", None)
    if kind not in ("vertex", "face"):
        return None
    colors = mesh.visual.vertex_colors if kind == "vertex" else mesh.visual.face_colors
    return mean_color(np.asarray(colors, np.uint8)[:, None, :])


def _resolver(asset: Asset, library: MeshLibrary) -> Any:
    from trimesh.resolvers import Resolver

    class OurResolver(Resolver):
        """Gives trimesh the bytes of what a mesh refers to, by our rules only."""

        def __init__(self) -> None:
            self.file_name = asset.path.name

        def get(self, key: str) -> bytes:
            name = str(key).strip()
            suffixes = MATERIALS | TEXTURES | BUFFERS
            try:
                return library.read(library.finder.nested(asset, name, suffixes))
            except ModelError as error:
                if asset.path.suffix.lower() == ".gltf" and not isinstance(
                        error, MissingAssetError):
                    raise
                missing = isinstance(error, MissingAssetError)
                library.note(f"{asset.path.name}: file {_last(name)!r} "
                             + ("is missing" if missing else "cannot be used"))
                raise FileNotFoundError(_last(name)) from error

        def write(self, name: str, data: Any) -> None:
            raise NotImplementedError

        def namespaced(self, namespace: str) -> Any:
            return self

        def keys(self) -> list[str]:
            return []

    return OurResolver()


def _check_gltf(data: bytes, kind: str) -> None:
    """Refuse by name what trimesh would misread or what would not fit into memory."""
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
    if any(not isinstance(c, int) or c < 0 for c in counts) or sum(counts) > 20 * MAX_TRIANGLES:
        raise ModelError("has accessors of impossible size")
    for buffer in header.get("buffers", []):
        uri = str(buffer.get("uri", ""))
        if not uri.startswith("data:") and (".." in uri.split("/") or ":" in uri
                                            or uri.startswith("/")):
            raise ModelError(f"refers to the buffer {uri[:60]!r}; it must lie beside the file")


def _last(reference: str) -> str:
    return reference.replace("\\", "/").rsplit("/", 1)[-1][:80]


def _named(path: Path, text: str) -> str:
    return text if text.startswith(str(path)) else f"{path}: {text}"
