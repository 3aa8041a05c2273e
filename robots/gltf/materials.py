"""Materials of a glTF file."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..files import MissingAssetError
from ..geometry import Array
from ..model import INVISIBLE, Maps, Material, TextureDecoder, Tiling, mean_color
from .accessors import Accessors
from .document import GltfDocument
from .records import GltfMaterial, GltfSampler, Quadruple, SpecularGlossiness, TextureInfo

_TILINGS: dict[int, Tiling] = {10497: "repeat", 33648: "mirror", 33071: "clamp"}


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

    def __init__(
        self, document: GltfDocument, accessors: Accessors, textures: TextureDecoder,
        allow_missing: bool,
    ) -> None:
        self._gltf, self._accessors, self._allow_missing = document.gltf, accessors, allow_missing
        self._textures = textures
        self._materials: dict[int, Material] = {}
        self._opaque: dict[int, tuple[NDArray[np.uint8], NDArray[np.uint8]]] = {}
        """Pictures with and without alpha, by the id of the former, which must live as long."""
        self.notes: dict[str, None] = {}

    def placement(self, material: int | None) -> Placement:
        """Return the placement of the colour texture, or else of the material's first texture."""
        if material is not None:
            for info in self._infos(material):
                if info is not None:
                    return _placement(info)
        return Placement(None, np.eye(2, 3))

    def material(
        self, material: int | None, has_uv: bool, vertex_color: Array | None
    ) -> tuple[Material, object]:
        """Return the material (mean texture colour without UVs) of a surface with vertex colours
        [V 4], and a key shared by equal ones.
        """
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
        if (found.blend and found.alpha_cutoff is None and vertex_color is not None
                and found.base_color[3] * vertex_color[:, 3].min() < INVISIBLE):
            found = replace(found, alpha_cutoff=INVISIBLE)
        return found, (material, has_uv, found.alpha_cutoff)

    def shows_alpha(self, material: int | None) -> bool:
        """Return whether the material uses the alpha of vertex colours."""
        return material is not None and self._gltf.materials[material].alpha_mode in (
            "MASK", "BLEND")

    def _infos(self, material: int) -> list[TextureInfo | None]:
        """Return the colour, metallic-roughness, normal, occlusion and emission textures."""
        given = self._gltf.materials[material]
        glossy = given.extensions.glossy
        colors = ([glossy.diffuse_texture, None] if glossy else
                  [given.pbr.base_color_texture, given.pbr.metallic_roughness_texture])
        return [*colors, given.normal_texture, given.occlusion_texture, given.emissive_texture]

    def _read(self, material: int) -> Material:
        given = self._gltf.materials[material]
        color, roughness = given.pbr.base_color_factor, given.pbr.roughness_factor
        metallic, glossy = given.pbr.metallic_factor, given.extensions.glossy
        picture, metal, normal, occlusion, glow = self._pictures(material)
        if glossy:
            roughness, metallic = 1.0 - glossy.glossiness_factor, 0.0
            color, picture = self._with_highlights(picture, glossy)
        mode = given.alpha_mode
        if mode not in ("OPAQUE", "MASK", "BLEND"):  # from a later 2.x
            self.notes[f"alpha mode {mode[:40]!r} is taken as OPAQUE"] = None
            mode = "OPAQUE"
        if mode == "OPAQUE" and picture is not None and picture.shape[2] == 4:
            if id(picture) not in self._opaque:
                without = self._count(np.ascontiguousarray(picture[..., :3]))
                self._opaque[id(picture)] = picture, without
            picture = self._opaque[id(picture)][1]
        r, g, b, a = np.clip(color, 0.0, 1.0).tolist()
        cutoff = None
        if mode == "MASK":
            cutoff = given.alpha_cutoff / max(a, 1e-6)
        elif mode == "BLEND" and (a < INVISIBLE or (picture is not None and picture.shape[2] == 4)):
            cutoff = INVISIBLE
        unlit = given.extensions.unlit is not None
        bump, shade = given.normal_texture, given.occlusion_texture
        maps = Maps() if unlit else Maps(
            metal, self._strength(normal, bump.scale if bump else 1.0, 0),
            self._strength(occlusion, shade.strength if shade else 1.0, 255), glow)
        first = next((info for info in self._infos(material) if info is not None), None)
        return Material(
            given.name or f"material_{material}", (r, g, b, 1.0 if mode != "BLEND" else a),
            float(np.clip(metallic, 0.0, 1.0)), float(np.clip(roughness, 0.0, 1.0)), picture,
            maps, ("repeat", "repeat") if first is None else self._tiling(first.index),
            (0.0, 0.0, 0.0) if unlit else _emission(given), unlit, cutoff, mode == "BLEND")

    def _pictures(self, material: int) -> list[NDArray[np.uint8] | None]:
        """Return the images of `_infos`; None for those not placed like the first one."""
        place = self.placement(material)
        pictures: list[NDArray[np.uint8] | None] = []
        for info in self._infos(material):
            picture = None
            if info is not None:
                other = _placement(info)
                if other.uv_set == place.uv_set and np.allclose(other.matrix, place.matrix):
                    picture = self._texture(info.index)
                else:
                    self.notes["textures that lie otherwise than their material's first are not "
                               "drawn"] = None
            pictures.append(picture)
        return pictures

    def _with_highlights(
        self, picture: NDArray[np.uint8] | None, glossy: SpecularGlossiness
    ) -> tuple[Quadruple, NDArray[np.uint8] | None]:
        """Return the base colour of a specular-glossiness material: the diffuse colour plus the
        specular reflection above 4 %, the value of dielectrics.
        """
        color, info = glossy.diffuse_factor, glossy.specular_glossiness_texture
        shine = np.clip(glossy.specular_factor, 0.0, 1.0)
        if info is None:
            mirrored = np.clip(shine - 0.04, 0.0, 1.0) / 0.96
            r, g, b = np.clip(np.add(color[:3], mirrored), 0.0, 1.0).tolist()
            return (r, g, b, color[3]), picture
        other = None if picture is None else self._texture(info.index)
        if picture is None or other is None or other.shape[:2] != picture.shape[:2]:
            return color, picture
        dielectric = 56.0  # 4 % as sRGB
        mirrored = np.clip(other[..., :3] * shine - dielectric, 0.0, None) * (
            255.0 / (255.0 - dielectric))
        out = picture.copy()
        out[..., :3] = np.clip(picture[..., :3] + mirrored, 0.0, 255.0).astype(np.uint8)
        return color, self._count(out)

    def _count(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return self._textures.count(picture, "a material")

    def _strength(
        self, picture: NDArray[np.uint8] | None, strength: float, rest: int
    ) -> NDArray[np.uint8] | None:
        """Scale the slopes of a normal map (rest 0), or the effect of an occlusion map (255)."""
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
        return self._count(np.round(out).astype(np.uint8))

    def _tiling(self, texture: int) -> tuple[Tiling, Tiling]:
        sampler = self._gltf.textures[texture].sampler
        given = GltfSampler() if sampler is None else self._gltf.samplers[sampler]
        return _TILINGS[given.wrap_s], _TILINGS[given.wrap_t]

    def _texture(self, number: int) -> NDArray[np.uint8] | None:
        texture = self._gltf.textures[number]
        source = texture.source if texture.extensions.webp.source is None \
            else texture.extensions.webp.source
        if source is None:
            self.notes[f"textures[{number}] has no image that can be read"] = None
            return None
        try:
            return self._textures.decode(*self._accessors.image(source))
        except MissingAssetError as error:
            if not self._allow_missing:
                raise MissingAssetError(f"images[{source}]: {error}; add --allow-missing to load "
                                        "the model without it") from error
            self.notes[f"images[{source}] is missing"] = None
            return None


def _placement(info: TextureInfo) -> Placement:
    moved = info.extensions.transform
    if moved is None:
        return Placement(info.tex_coord, np.eye(2, 3))
    uv_set = info.tex_coord if moved.tex_coord is None else moved.tex_coord
    (sx, sy), (x, y) = moved.scale, moved.offset
    c, s = np.cos(moved.rotation), np.sin(moved.rotation)
    return Placement(uv_set, np.array([[c * sx, s * sy, x], [-s * sx, c * sy, y]]))


def _emission(given: GltfMaterial) -> tuple[float, float, float]:
    strength = given.extensions.emissive_strength.emissive_strength
    r, g, b = np.clip(np.multiply(given.emissive_factor, strength), 0.0, 100.0).tolist()
    return r, g, b
