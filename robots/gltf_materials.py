"""Materials of a glTF file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pygltflib
from numpy.typing import NDArray

from .geometry import Array
from .gltf_accessors import Accessors
from .gltf_document import Document, dictionary, index, integer, number, numbers
from .model import Material, ModelError
from .references import MissingAssetError
from .texture import decode_texture, mean_color

MAX_TEXTURE_BYTES = 2**30
"""Of all decoded textures of a file."""


@dataclass(frozen=True)
class Look:
    """Where on its textures a material's surface lies."""

    uv_set: int | None
    """Of TEXCOORD; None: it has no texture"""
    uv_matrix: Array
    """[2 3] from the file's coordinates (v downward) to those of the texture"""

    def uv(self, file_uv: Array) -> Array:
        """[V 2] v upward, from the file's [V 2]."""
        u, v = (file_uv @ self.uv_matrix[:, :2].T + self.uv_matrix[:, 2]).T
        return np.stack([u, 1.0 - v], 1)


class Materials:
    """Reads each material and image of one document once."""

    def __init__(self, document: Document, accessors: Accessors, allow_missing: bool) -> None:
        self._gltf, self._accessors, self._allow_missing = document.gltf, accessors, allow_missing
        self._materials: dict[int | None, Material] = {}
        self._images: dict[int, NDArray[np.uint8] | None] = {}
        self._bytes = 0
        self._counts = {name: len(getattr(document.gltf, name)) for name in ("textures", "images")}
        self.notes: dict[str, None] = {}

    def look(self, material: int | None) -> Look:
        info = None if material is None else self._base_texture(material)
        if info is None:
            return Look(None, np.eye(2, 3))
        where = f"materials[{material}]"
        moved = self._extension(info, "KHR_texture_transform", where)
        uv_set = integer(high=15)(moved.get("texCoord", info.texCoord or 0), where, {})
        return Look(uv_set, _uv_matrix(moved, where))

    def material(self, material: int | None, has_uv: bool) -> tuple[Material, object]:
        """The material, and a key that equal ones share. Without UVs a texture is its mean."""
        if material not in self._materials:
            self._materials[material] = (Material("default", (1.0, 1.0, 1.0, 1.0), 1.0, 1.0)
                                         if material is None else self._read(material))
        found = self._materials[material]
        if found.texture is not None and not has_uv:
            r, g, b, a = np.multiply(mean_color(found.texture), found.base_color).tolist()
            found = replace(found, texture=None, base_color=(r, g, b, a))
        return found, (material, has_uv)

    def _base_texture(self, material: int) -> pygltflib.TextureInfo | None:
        given = self._gltf.materials[material]
        glossy = self._extension(given, "KHR_materials_pbrSpecularGlossiness", "material")
        if "diffuseTexture" in glossy:
            info = dictionary(glossy["diffuseTexture"], "diffuseTexture", {})
            return pygltflib.TextureInfo(
                index=index("textures")(info.get("index"), "diffuseTexture", self._counts),
                texCoord=integer(high=15)(info.get("texCoord", 0), "diffuseTexture", {}),
                extensions=dictionary(info.get("extensions", {}), "diffuseTexture", {}))
        pbr = given.pbrMetallicRoughness
        return None if pbr is None or glossy else pbr.baseColorTexture

    def _read(self, material: int) -> Material:
        given, where = self._gltf.materials[material], f"materials[{material}]"
        pbr = given.pbrMetallicRoughness or pygltflib.PbrMetallicRoughness()
        color = pbr.baseColorFactor or (1.0, 1.0, 1.0, 1.0)
        metallic = 1.0 if pbr.metallicFactor is None else pbr.metallicFactor
        roughness = 1.0 if pbr.roughnessFactor is None else pbr.roughnessFactor
        glossy = self._extension(given, "KHR_materials_pbrSpecularGlossiness", where)
        if glossy:
            color = numbers(4)(glossy.get("diffuseFactor", [1.0] * 4), where, {})
            roughness = 1.0 - number(glossy.get("glossinessFactor", 1.0), where, {})
            metallic = 0.0
        r, g, b, a = np.clip(color, 0.0, 1.0).tolist()
        info = self._base_texture(material)
        return Material(
            str(given.name or f"material_{material}"),
            (r, g, b, 1.0 if given.alphaMode in (None, "OPAQUE") else a),
            float(np.clip(metallic, 0.0, 1.0)), float(np.clip(roughness, 0.0, 1.0)),
            None if info is None else self._texture(int(info.index)))

    def _texture(self, number_of_texture: int) -> NDArray[np.uint8] | None:
        texture = self._gltf.textures[number_of_texture]
        webp = self._extension(texture, "EXT_texture_webp", "texture")
        source = texture.source
        if "source" in webp:
            source = index("images")(webp["source"], f"textures[{number_of_texture}]",
                                     self._counts)
        if source is None:
            self.notes[f"textures[{number_of_texture}] has no image that can be read"] = None
            return None
        if source not in self._images:
            self._images[source] = self._image(source)
        return self._images[source]

    def _image(self, source: int) -> NDArray[np.uint8] | None:
        try:
            data, name = self._accessors.image(source)
        except MissingAssetError as error:
            if not self._allow_missing:
                raise MissingAssetError(f"images[{source}]: {error}; set allow_missing to go "
                                        "without") from error
            self.notes[f"images[{source}] is missing"] = None
            return None
        picture = decode_texture(data, name)
        self._bytes += picture.nbytes
        if self._bytes > MAX_TEXTURE_BYTES:
            raise ModelError(f"has more than {MAX_TEXTURE_BYTES} bytes of textures")
        return picture

    def _extension(self, holder: Any, name: str, where: str) -> Mapping[str, Any]:
        found = (holder.extensions or {}).get(name)
        return {} if found is None else dictionary(found, f"{where}.{name}", {})


def _uv_matrix(moved: Mapping[str, Any], where: str) -> Array:
    """[2 3] of KHR_texture_transform: translation * rotation * scale."""
    x, y = numbers(2)(moved.get("offset", [0.0, 0.0]), where, {})
    turn = number(moved.get("rotation", 0.0), where, {})
    sx, sy = numbers(2)(moved.get("scale", [1.0, 1.0]), where, {})
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c * sx, s * sy, x], [-s * sx, c * sy, y]])
