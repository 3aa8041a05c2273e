"""Materials of a glTF file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pygltflib
from numpy.typing import NDArray

from ...errors import ModelError
from ..files import MissingAssetError
from ..geometry import Array
from ..model import Maps, Material, Tiling, decode_texture, mean_color
from .accessors import Accessors
from .document import GltfDocument, dictionary, index, integer, number, numbers

MAX_TEXTURE_BYTES = 2**30
"""Limit on the sum over all decoded textures of a file."""
INVISIBLE = 0.02
"""A blended surface with a lower alpha is not drawn."""
_TILINGS: dict[int, Tiling] = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
_Info = pygltflib.TextureInfo | pygltflib.NormalMaterialTexture | pygltflib.OcclusionTextureInfo


@dataclass(frozen=True)
class Placement:
    """Texture coordinates of a material."""

    uv_set: int | None
    """n of TEXCOORD_n; None for a material without texture"""
    matrix: Array
    """[2 3] texture from file coordinates (v downward)"""

    def uv(self, file_uv: Array) -> Array:
        """Return coordinates [V 2] with v upward, from the file's [V 2]."""
        u, v = (file_uv @ self.matrix[:, :2].T + self.matrix[:, 2]).T
        return np.stack([u, 1.0 - v], 1)


class Materials:
    """Cached reader of the materials and images of one document."""

    def __init__(self, document: GltfDocument, accessors: Accessors, allow_missing: bool) -> None:
        self._gltf, self._accessors, self._allow_missing = document.gltf, accessors, allow_missing
        self._materials: dict[int, Material] = {}
        self._images: dict[int, NDArray[np.uint8] | None] = {}
        self._opaque: dict[int, NDArray[np.uint8]] = {}
        self._bytes = 0
        self._counts = {name: len(getattr(document.gltf, name)) for name in ("textures", "images")}
        self.notes: dict[str, None] = {}

    def placement(self, material: int | None) -> Placement:
        """Return the placement of the colour texture, or else of the material's first texture."""
        if material is not None:
            for info in self._infos(material):
                if info is not None:
                    return self._placement(info, f"materials[{material}]")
        return Placement(None, np.eye(2, 3))

    def material(self, material: int | None, has_uv: bool) -> tuple[Material, object]:
        """Return the material (mean texture colour without UVs), and a key shared by equal ones."""
        if material is None:
            return Material("default", (1.0, 1.0, 1.0, 1.0), 1.0, 1.0), None
        if material not in self._materials:
            self._materials[material] = self._read(material)
        found = self._materials[material]
        if not has_uv:
            color = found.base_color
            if found.texture is not None:
                r, g, b, a = np.multiply(mean_color(found.texture), color).tolist()
                color = (r, g, b, a)
            found = replace(found, texture=None, base_color=color, maps=Maps())
        return found, (material, has_uv)

    def shows_alpha(self, material: int | None) -> bool:
        """Return whether the material uses the alpha of vertex colours."""
        return material is not None and self._gltf.materials[material].alphaMode in (
            "MASK", "BLEND")

    def _infos(self, material: int) -> list[_Info | None]:
        """Return the colour, metallic-roughness, normal, occlusion and emission textures."""
        given = self._gltf.materials[material]
        pbr = given.pbrMetallicRoughness or pygltflib.PbrMetallicRoughness()
        color, metal = pbr.baseColorTexture, pbr.metallicRoughnessTexture
        glossy = self._extension(given, "KHR_materials_pbrSpecularGlossiness", "material")
        if glossy:
            color, metal = None, None
        if "diffuseTexture" in glossy:
            where = f"materials[{material}].diffuseTexture"
            info = dictionary(glossy["diffuseTexture"], where, {})
            color = pygltflib.TextureInfo(
                index=index("textures")(info.get("index"), where, self._counts),
                texCoord=integer(high=15)(info.get("texCoord", 0), where, {}),
                extensions=dictionary(info.get("extensions", {}), where, {}))
        return [color, metal, given.normalTexture, given.occlusionTexture, given.emissiveTexture]

    def _placement(self, info: _Info, where: str) -> Placement:
        moved = self._extension(info, "KHR_texture_transform", where)
        uv_set = integer(high=15)(moved.get("texCoord", info.texCoord or 0), where, {})
        return Placement(uv_set, _uv_matrix(moved, where))

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
        picture, metal, normal, occlusion, glow = self._pictures(material)
        if glossy:
            color, picture = self._with_highlights(color, picture, glossy, where)
        unlit = "KHR_materials_unlit" in (given.extensions or {})
        mode = given.alphaMode or "OPAQUE"
        if mode not in ("OPAQUE", "MASK", "BLEND"):  # from a later 2.x
            self.notes[f"alpha mode {mode[:40]!r} is taken as OPAQUE"] = None
            mode = "OPAQUE"
        if mode == "OPAQUE" and picture is not None and picture.shape[2] == 4:
            picture = self._opaque.setdefault(id(picture), np.ascontiguousarray(picture[..., :3]))
        r, g, b, a = np.clip(color, 0.0, 1.0).tolist()
        cutoff = None
        if mode == "MASK":
            cutoff = (0.5 if given.alphaCutoff is None else given.alphaCutoff) / max(a, 1e-6)
        elif mode == "BLEND" and (a < INVISIBLE or (picture is not None and picture.shape[2] == 4)):
            cutoff = INVISIBLE
        bump, shade = given.normalTexture, given.occlusionTexture
        maps = Maps() if unlit else Maps(
            metal, _strength(normal, 1.0 if bump is None or bump.scale is None else bump.scale, 0),
            _strength(occlusion, 1.0 if shade is None or shade.strength is None
                      else shade.strength, 255), glow)
        first = next((info for info in self._infos(material) if info is not None), None)
        return Material(
            str(given.name or f"material_{material}"), (r, g, b, 1.0 if mode != "BLEND" else a),
            float(np.clip(metallic, 0.0, 1.0)), float(np.clip(roughness, 0.0, 1.0)), picture,
            maps, ("repeat", "repeat") if first is None else self._tiling(int(
                cast("int", first.index))), (0.0, 0.0, 0.0) if unlit else self._emission(material),
            unlit, cutoff, mode == "BLEND")

    def _pictures(self, material: int) -> list[NDArray[np.uint8] | None]:
        """Return the images of `_infos`; None for those not placed like the first one."""
        place = self.placement(material)
        pictures: list[NDArray[np.uint8] | None] = []
        for info in self._infos(material):
            picture = None
            if info is not None:
                other = self._placement(info, f"materials[{material}]")
                if other.uv_set == place.uv_set and np.allclose(other.matrix, place.matrix):
                    picture = self._texture(int(cast("int", info.index)))
                else:
                    self.notes["textures that lie otherwise than their material's first are not "
                               "drawn"] = None
            pictures.append(picture)
        return pictures

    def _with_highlights(
        self, color: Sequence[float], picture: NDArray[np.uint8] | None,
        glossy: Mapping[str, Any], where: str,
    ) -> tuple[Sequence[float], NDArray[np.uint8] | None]:
        """Return the base colour of a specular-glossiness material: the diffuse colour plus the
        specular reflection above 4 %, the value of dielectrics.
        """
        shine = np.clip(numbers(3)(glossy.get("specularFactor", [1.0] * 3), where, {}), 0.0, 1.0)
        if "specularGlossinessTexture" not in glossy or picture is None:
            if "specularGlossinessTexture" not in glossy:
                mirrored = np.clip(shine - 0.04, 0.0, 1.0) / 0.96
                color = [*np.clip(np.add(color[:3], mirrored), 0.0, 1.0).tolist(), color[3]]
            return color, picture
        info = dictionary(glossy["specularGlossinessTexture"], where, {})
        other = self._texture(index("textures")(info.get("index"), where, self._counts))
        if other is None or other.shape[:2] != picture.shape[:2]:
            return color, picture
        dielectric = 56.0  # 4 % as sRGB
        mirrored = np.clip(other[..., :3] * shine - dielectric, 0.0, None) * (
            255.0 / (255.0 - dielectric))
        out = picture.copy()
        out[..., :3] = np.clip(picture[..., :3] + mirrored, 0.0, 255.0).astype(np.uint8)
        return color, out

    def _emission(self, material: int) -> tuple[float, float, float]:
        given = self._gltf.materials[material]
        name = "KHR_materials_emissive_strength"
        strong = self._extension(given, name, f"materials[{material}]")
        strength = number(strong.get("emissiveStrength", 1.0), name, {})
        r, g, b = np.clip(np.multiply(given.emissiveFactor or (0.0, 0.0, 0.0), strength),
                          0.0, 100.0).tolist()
        return r, g, b

    def _tiling(self, texture: int) -> tuple[Tiling, Tiling]:
        sampler = self._gltf.textures[texture].sampler
        if sampler is None:
            return "repeat", "repeat"
        given = self._gltf.samplers[sampler]
        return _TILINGS[given.wrapS or 10497], _TILINGS[given.wrapT or 10497]

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


def _strength(picture: NDArray[np.uint8] | None, strength: float, rest: int
              ) -> NDArray[np.uint8] | None:
    """Scale the slopes of a normal map (rest 0), or the effect of an occlusion map (rest 255)."""
    if picture is None or strength == 1.0:
        return picture
    out = picture[..., :3].astype(np.float32)
    if rest:
        out = rest + np.clip(strength, 0.0, 1.0) * (out - rest)
    else:
        normal = out / 127.5 - 1.0
        normal[..., :2] *= np.clip(strength, -100.0, 100.0)
        normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-6)
        out = (normal + 1.0) * 127.5
    return np.round(out).astype(np.uint8)


def _uv_matrix(moved: Mapping[str, Any], where: str) -> Array:
    """Return [2 3] of a KHR_texture_transform: translation * rotation * scale."""
    x, y = numbers(2)(moved.get("offset", [0.0, 0.0]), where, {})
    turn = number(moved.get("rotation", 0.0), where, {})
    sx, sy = numbers(2)(moved.get("scale", [1.0, 1.0]), where, {})
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c * sx, s * sy, x], [-s * sx, c * sy, y]])
