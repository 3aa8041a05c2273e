"""The surfaces that parts carry: triangles, materials, skins and morph targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array

Tiling = Literal["repeat", "mirror", "clamp"]
INVISIBLE = 0.02
"""A transparent surface with a lower alpha has neither colour nor depth."""


@dataclass(frozen=True)
class Maps:
    """Textures of a surface beside its colour (glTF 2.0, section 3.9): [h w 3|4], row 0 on top."""

    metallic_roughness: NDArray[np.uint8] | None = None
    """Green multiplies the roughness, blue the metallic factor."""
    normal: NDArray[np.uint8] | None = None
    """Normal in the frame of the texture (u, v upward, outward), -1..1 as 0..255."""
    occlusion: NDArray[np.uint8] | None = None
    """Red multiplies the light that is reflected."""
    emission: NDArray[np.uint8] | None = None
    """sRGB; multiplies the material's emission."""


@dataclass(frozen=True)
class Material:
    """Appearance of a surface (metallic-roughness, as in glTF 2.0)."""

    name: str = ""
    base_color: tuple[float, float, float, float] = (0.5, 0.5, 0.5, 1.0)
    """Linear RGBA in 0..1 (not sRGB); multiplies the texture."""
    metallic: float = 0.0
    roughness: float = 0.6
    texture: NDArray[np.uint8] | None = None
    """[h w 3|4] sRGB, row 0 is the top of the image (v = 1)."""
    maps: Maps = Maps()
    tiling: tuple[Tiling, Tiling] = ("repeat", "repeat")
    """Tiling of the textures outside 0..1, in u and v."""
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Linear RGB of emitted light."""
    unlit: bool = False
    """Whether the base colour is shown without shading."""
    alpha_cutoff: float | None = None
    """Pixels with less alpha (product of base colour, texture and vertex colour) have neither
    colour nor depth."""
    blend: bool = False
    """Whether alpha of texture and vertex colours makes the surface transparent; alpha of the base
    colour always does."""

    @property
    def transparent(self) -> bool:
        return self.blend or self.base_color[3] < 1.0


@dataclass(frozen=True, eq=False)
class Skin:
    """Linear blend skinning: vertices follow several parts (glTF 2.0, section 3.7.3.1)."""

    bone_part: NDArray[np.int64]
    """[B] index of the part of each bone."""
    part_from_mesh: Array
    """[B 4 4] affine: a vertex as stored to the bone's part frame (inverse bind, scale baked)."""
    bone: NDArray[np.int64]
    """[V K] index into the bones."""
    weight: Array
    """[V K], rows sum to 1."""


@dataclass(frozen=True, eq=False)
class Morph:
    """Displacements of vertices, each scaled by a weight of the model (glTF morph targets)."""

    channel: NDArray[np.int64]
    """[M] index into the model's morph weights."""
    displacement: Array
    """[M V 3] m, in the frame of the stored vertices; added before the skin."""
    normal_displacement: Array | None
    """[M V 3]"""


@dataclass(frozen=True, eq=False)
class Visual:
    """The triangles of one part that share a material."""

    part: int
    """Index into the model's parts (0-based), which masks show for these triangles. With a skin it
    is the part that the triangles follow most."""
    vertices: Array
    """[V 3] m, in the part's frame; with a skin, in the mesh's own."""
    faces: NDArray[np.int32]
    """[F 3] counter-clockwise from outside."""
    normals: Array
    """[V 3] unit."""
    uv: Array | None
    """[V 2], (0, 0) at the bottom left as in OpenGL and OBJ; None where the mesh has none."""
    material: Material
    skin: Skin | None = None
    morph: Morph | None = None
    color: Array | None = None
    """[V 4] linear RGBA that multiplies the material's base colour."""

    @property
    def deforms(self) -> bool:
        """Whether the vertices move against the part."""
        return self.skin is not None or self.morph is not None
