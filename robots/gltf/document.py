"""Parser of glTF 2.0 files into records with checked types and indices."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec

from ...errors import ModelError
from .records import LISTS, MAX_OBJECTS, Gltf, GltfAsset, GltfObject, NodeIndex

MAX_JSON_BYTES = 64 * 2**20
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


class _Head(GltfObject):
    asset: GltfAsset | None = None
    extensions_used: tuple[str, ...] = ()
    extensions_required: tuple[str, ...] = ()


class _Object(msgspec.Struct):
    """Any JSON object."""


_Lists = msgspec.defstruct("_Lists", [(name, list[_Object], []) for name in LISTS.values()])
_Kind = TypeVar("_Kind")


@dataclass(frozen=True)
class GltfDocument:
    """Objects of a glTF file with valid indices, and the binary chunk."""

    gltf: Gltf
    asset: GltfAsset
    binary: bytes | None
    """Binary chunk of a GLB file."""
    notes: tuple[str, ...]


def read_gltf_document(data: bytes) -> GltfDocument:
    """Parse the bytes of a .glb or .gltf file; raise ModelError."""
    text, binary = _chunks(data) if data[:4] == b"glTF" else (data, None)
    if len(text) > MAX_JSON_BYTES:
        raise ModelError(f"has more than {MAX_JSON_BYTES} bytes of JSON")
    text = text.removeprefix(b"\xef\xbb\xbf")
    try:
        text.decode()  # msgspec skips what it does not need without a look
    except UnicodeDecodeError as error:
        raise ModelError(f"is not a glTF file: its JSON is not UTF-8 ({error})") from error
    asset, notes = _check_version_and_extensions(_decode(text, _Head))
    lists = _decode(text, _Lists)
    counts = {kind: len(getattr(lists, name)) for kind, name in LISTS.items()}
    if sum(counts.values()) > MAX_OBJECTS or counts[NodeIndex] > MAX_NODES:
        raise ModelError(f"has more than {MAX_OBJECTS} objects or {MAX_NODES} nodes")
    return GltfDocument(_decode(text, Gltf, counts), asset, binary, tuple(notes))


def _decode(text: bytes, kind: type[_Kind], counts: dict[type[int], int] | None = None) -> _Kind:
    """Return the record in JSON text; `counts` holds the number of objects of each list."""
    def index(kind: type[int], value: Any) -> int:
        count = (counts or {})[kind]
        if isinstance(value, bool) or not isinstance(value, int | float) or value != int(value):
            raise ValueError("expected an index")
        if not 0 <= value < count:
            raise ValueError(f"index {int(value)} of {count} {LISTS[kind]}")
        return kind(value)

    try:  # not strict, because some files write 3.0 for 3
        return msgspec.json.decode(text, type=kind, strict=False, dec_hook=index)
    except msgspec.ValidationError as error:
        what, _, where = str(error).replace("`", "").partition(" - at $.")
        raise ModelError(f"{where or 'is not a glTF file'}: {what[0].lower()}{what[1:]}") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ModelError(f"is not a glTF file: its JSON is broken ({error})") from error


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


def _check_version_and_extensions(head: _Head) -> tuple[GltfAsset, list[str]]:
    """Refuse unsupported versions and extensions; return the asset and notes on the ignored."""
    asset = head.asset
    if asset is None:
        raise ModelError("is not a glTF 2.0 file: it has no asset")
    if not isinstance(asset.version, str) or asset.version.split(".")[0] != "2":
        raise ModelError(f"is glTF of version {ascii(asset.version)[:40]}; export it as glTF 2.0")
    if asset.min_version != "2.0":
        raise ModelError(f"needs glTF of version {ascii(asset.min_version)[:40]}; 2.0 is what is "
                         "read")
    unknown = sorted(set(head.extensions_required) - DRAWN - SURFACES_ONLY)
    if unknown:
        raise ModelError(f"requires the glTF extension {', '.join(unknown[:5])}, which is not "
                         "supported; export it without")
    left_out = sorted(set(head.extensions_used) - DRAWN)
    return asset, [f"glTF extensions that are not drawn: {', '.join(left_out[:20])}"
                   ] if left_out else []
