"""Parser of the JSON of a glTF 2.0 file into pygltflib objects with checked types.

The objects are built here field by field, because pygltflib's decoder does not check types, takes
0.3 ms per object, and ignores the weights of nodes.
"""

# pyright: reportUnknownLambdaType=false

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import pygltflib

from ...errors import ModelError

MAX_JSON_BYTES = 64 * 2**20
MAX_OBJECTS = 200_000
MAX_NODES = 20_000

DRAWN = frozenset({
    "KHR_materials_emissive_strength", "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_unlit", "KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp",
})
"""Supported extensions."""
SURFACES_ONLY = frozenset({
    "EXT_lights_image_based", "EXT_mesh_features", "EXT_structural_metadata",
    "KHR_lights_punctual", "KHR_materials_anisotropy", "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission", "KHR_materials_dispersion", "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_sheen", "KHR_materials_specular", "KHR_materials_transmission",
    "KHR_materials_variants", "KHR_materials_volume",
    "KHR_materials_volume_scatter", "KHR_xmp", "KHR_xmp_json_ld",
})
"""Ignored extensions: they change only appearance or lighting, or hold metadata."""

Counts = Mapping[str, int]
Checker = Callable[[Any, str, Counts], Any]
"""(value, JSON path, number of objects by kind) -> checked value; raises ModelError."""


@dataclass
class Node(pygltflib.Node):
    """Node of pygltflib, with the missing field `weights`."""

    weights: list[float] | None = None


@dataclass(frozen=True)
class GltfDocument:
    """Objects of a glTF file with valid indices, and the binary chunk."""

    gltf: pygltflib.GLTF2
    binary: bytes | None
    """Binary chunk of a GLB file."""
    notes: tuple[str, ...]


def read_gltf_document(data: bytes) -> GltfDocument:
    """Parse the bytes of a .glb or .gltf file; raise ModelError."""
    text, binary = _chunks(data) if data[:4] == b"glTF" else (data, None)
    if len(text) > MAX_JSON_BYTES:
        raise ModelError(f"has more than {MAX_JSON_BYTES} bytes of JSON")
    try:
        tree = json.loads(text.decode("utf-8-sig"), parse_constant=_no_number)
    except UnicodeDecodeError as error:
        raise ModelError("is not a glTF file: its JSON is not UTF-8 text") from error
    except (ValueError, RecursionError) as error:
        raise ModelError(f"is not a glTF file: its JSON is broken ({error})") from error
    if not isinstance(tree, dict):
        raise ModelError("is not a glTF file: its JSON is not an object")
    top = cast("dict[str, Any]", tree)
    notes = _check_version_and_extensions(top)
    counts = {name: len(top[name]) if isinstance(top.get(name), list) else 0 for name in _TOP}
    if sum(counts.values()) > MAX_OBJECTS or counts["nodes"] > MAX_NODES:
        raise ModelError(f"has more than {MAX_OBJECTS} objects or {MAX_NODES} nodes")
    values = {name: check(top[name], name, counts) for name, check in _TOP.items() if name in top}
    if "scene" in top:
        values["scene"] = index("scenes")(top["scene"], "scene", counts)
    return GltfDocument(pygltflib.GLTF2(**values), binary, tuple(notes))


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """Return the JSON and the binary chunk of a GLB file."""
    if len(data) < 20:
        raise ModelError("is not a whole GLB file: it ends within its header")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise ModelError(f"is a GLB file of version {version}; export it as glTF 2.0")
    if length > len(data):
        raise ModelError(f"is not a whole GLB file: it has {len(data)} bytes of {length}")
    found: list[tuple[int, bytes]] = []
    at = 12
    while at + 8 <= length and len(found) < 2:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise ModelError("is not a whole GLB file: a chunk reaches beyond its end")
        found.append((kind, data[at + 8:at + 8 + size]))
        at += 8 + size
    if not found or found[0][0] != 0x4E4F534A:
        raise ModelError("is not a GLB file: its first chunk is not JSON")
    binary = found[1][1] if len(found) > 1 and found[1][0] == 0x004E4942 else None
    return found[0][1].rstrip(b"\0"), binary


def _check_version_and_extensions(top: dict[str, Any]) -> list[str]:
    """Refuse unsupported versions and extensions; return notes on ignored extensions."""
    if "asset" not in top:
        raise ModelError("is not a glTF 2.0 file: it has no asset")
    asset: Any = top["asset"]
    version = asset.get("version") if isinstance(asset, dict) else None
    if not isinstance(version, str) or version.split(".")[0] != "2":
        raise ModelError(f"is glTF of version {_short(version)}; export it as glTF 2.0")
    least = cast("dict[str, Any]", asset).get("minVersion", "2.0")
    if least != "2.0":
        raise ModelError(f"needs glTF of version {_short(least)}; 2.0 is what is read")
    used, required = (cast("list[str]", _list(_text)(top.get(key, []), key, {}))
                      for key in ("extensionsUsed", "extensionsRequired"))
    unknown = sorted(set(required) - DRAWN - SURFACES_ONLY)
    if unknown:
        raise ModelError(f"requires the glTF extension {', '.join(unknown[:5])}, which is not "
                         "supported; export it without")
    left_out = sorted(set(used) - DRAWN)
    return [f"glTF extensions that are not drawn: {', '.join(left_out[:20])}"] if left_out else []


# -- checks of values ------------------------------------------------------------------------


def index(kind: str) -> Checker:
    """Return a checker of indices of objects of `kind`."""
    def check(value: Any, where: str, counts: Counts) -> int:
        number = integer()(value, where, counts)
        if number >= counts[kind]:
            raise ModelError(f"{where} is {number}, and there are {counts[kind]} {kind}")
        return number
    return check


def integer(low: int = 0, high: int = 2**53) -> Checker:
    def check(value: Any, where: str, counts: Counts) -> int:
        if isinstance(value, bool) or not isinstance(value, int | float) or value != value // 1:
            raise ModelError(f"{where} is {_short(value)}, which is not an integer")
        if not low <= value <= high:
            raise ModelError(f"{where} is {_short(value)}, outside {low} to {high}")
        return int(value)
    return check


def number(value: Any, where: str, counts: Counts) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > 1e30:
        raise ModelError(f"{where} is {_short(value)}, which is not a usable number")
    return float(value)


def numbers(length: int) -> Checker:
    return _list(number, length, length)


def _text(value: Any, where: str, counts: Counts) -> str:
    if not isinstance(value, str):
        raise ModelError(f"{where} is {_short(value)}, which is not a text")
    return value


def _flag(value: Any, where: str, counts: Counts) -> bool:
    if not isinstance(value, bool):
        raise ModelError(f"{where} is {_short(value)}, which is neither true nor false")
    return value


def _one_of(*values: object) -> Checker:
    def check(value: Any, where: str, counts: Counts) -> Any:
        if isinstance(value, bool) or value not in values:
            known = ", ".join(map(str, values))
            raise ModelError(f"{where} is {_short(value)}; it may be {known}")
        return value
    return check


def _list(item: Checker, least: int = 0, most: int = MAX_OBJECTS) -> Checker:
    def check(value: Any, where: str, counts: Counts) -> list[Any]:
        if not isinstance(value, list):
            raise ModelError(f"{where} is {_short(value)}, which is not a list")
        values = cast("list[Any]", value)
        if not least <= len(values) <= most:
            wanted = str(least) if least == most else f"{least} to {most}"
            raise ModelError(f"{where} has {len(values)} entries, not {wanted}")
        return [item(v, f"{where}[{i}]", counts) for i, v in enumerate(values)]
    return check


def dictionary(value: Any, where: str, counts: Counts) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ModelError(f"{where} is {_short(value)}, which is not an object")
    return cast("dict[str, Any]", value)


def _attributes(value: Any, where: str, counts: Counts) -> dict[str, int]:
    return {name: index("accessors")(v, f"{where}.{name}", counts)
            for name, v in dictionary(value, where, counts).items()}


def _object(make: Callable[..., Any], *required: str, **fields: Checker) -> Checker:
    """Return a checker that builds an object from `fields` and extensions; it ignores the rest."""
    known = {**fields, "extensions": dictionary}

    def check(value: Any, where: str, counts: Counts) -> Any:
        given = dictionary(value, where, counts)
        for name in required:
            if name not in given:
                raise ModelError(f"{where} has no {name}")
        return make(**{name: known[name](v, f"{where}.{name}", counts)
                       for name, v in given.items() if name in known})
    return check


def _no_number(text: str) -> float:
    raise ModelError(f"is not a glTF file: its JSON holds {text}")


def _short(value: Any) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return "not finite"
    text = " ".join(repr(value)[:200].split())
    return text if len(text) <= 40 else text[:37] + "..."


# -- the objects of glTF 2.0 -----------------------------------------------------------------

_COMPONENT = _one_of(5120, 5121, 5122, 5123, 5125, 5126)
_TEXTURE = {"index": index("textures"), "texCoord": integer(high=15)}
_SPARSE = _object(
    pygltflib.Sparse, "count", "indices", "values", count=integer(1),
    indices=_object(pygltflib.AccessorSparseIndices, "bufferView", "componentType",
                    bufferView=index("bufferViews"), byteOffset=integer(),
                    componentType=_one_of(5121, 5123, 5125)),
    values=_object(pygltflib.AccessorSparseValues, "bufferView",
                   bufferView=index("bufferViews"), byteOffset=integer()))
_PRIMITIVE = _object(
    pygltflib.Primitive, "attributes", attributes=_attributes, indices=index("accessors"),
    mode=integer(high=6), material=index("materials"), targets=_list(_attributes, most=1000))
_PBR = _object(
    pygltflib.PbrMetallicRoughness, baseColorFactor=numbers(4), metallicFactor=number,
    roughnessFactor=number, baseColorTexture=_object(pygltflib.TextureInfo, "index", **_TEXTURE),
    metallicRoughnessTexture=_object(pygltflib.TextureInfo, "index", **_TEXTURE))
_TOP: dict[str, Checker] = {
    "accessors": _list(_object(
        pygltflib.Accessor, "componentType", "count", "type",
        bufferView=index("bufferViews"), byteOffset=integer(), componentType=_COMPONENT,
        normalized=_flag, count=integer(1), sparse=_SPARSE,
        type=_one_of("SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"))),
    "animations": _list(_object(
        pygltflib.Animation, "channels", "samplers", name=_text,
        # sampler indices are local to the animation; the animation reader checks them
        channels=_list(_object(
            pygltflib.AnimationChannel, "sampler", "target", sampler=integer(),
            target=_object(pygltflib.AnimationChannelTarget, "path",
                           node=index("nodes"), path=_text))),
        samplers=_list(_object(
            pygltflib.AnimationSampler, "input", "output", input=index("accessors"),
            interpolation=_one_of("LINEAR", "STEP", "CUBICSPLINE"), output=index("accessors"))))),
    "asset": _object(pygltflib.Asset, "version", copyright=_text, version=_text,
                     extras=lambda value, where, counts: value),
    "bufferViews": _list(_object(
        pygltflib.BufferView, "buffer", "byteLength", buffer=index("buffers"),
        byteOffset=integer(), byteLength=integer(1), byteStride=integer(4, 252))),
    "buffers": _list(_object(pygltflib.Buffer, "byteLength", uri=_text, byteLength=integer(1))),
    "images": _list(_object(pygltflib.Image, uri=_text, mimeType=_text,
                            bufferView=index("bufferViews"), name=_text)),
    "materials": _list(_object(
        pygltflib.Material, pbrMetallicRoughness=_PBR, name=_text, emissiveFactor=numbers(3),
        normalTexture=_object(pygltflib.NormalMaterialTexture, "index", scale=number, **_TEXTURE),
        occlusionTexture=_object(pygltflib.OcclusionTextureInfo, "index", strength=number,
                                 **_TEXTURE),
        emissiveTexture=_object(pygltflib.TextureInfo, "index", **_TEXTURE),
        alphaMode=_text, alphaCutoff=number, doubleSided=_flag)),
    "meshes": _list(_object(pygltflib.Mesh, "primitives", primitives=_list(_PRIMITIVE, 1),
                            weights=_list(number, most=1000), name=_text)),
    "nodes": _list(_object(
        Node, mesh=index("meshes"), skin=index("skins"), name=_text, children=_list(index("nodes")),
        rotation=numbers(4), translation=numbers(3), scale=numbers(3), matrix=numbers(16),
        weights=_list(number, most=1000))),
    "samplers": _list(_object(
        pygltflib.Sampler, magFilter=integer(), minFilter=integer(),
        wrapS=_one_of(33071, 33648, 10497), wrapT=_one_of(33071, 33648, 10497))),
    "scenes": _list(_object(pygltflib.Scene, name=_text, nodes=_list(index("nodes")))),
    "skins": _list(_object(
        pygltflib.Skin, "joints", inverseBindMatrices=index("accessors"),
        joints=_list(index("nodes"), 1), name=_text)),
    "textures": _list(_object(pygltflib.Texture, sampler=index("samplers"),
                              source=index("images"), name=_text)),
}
