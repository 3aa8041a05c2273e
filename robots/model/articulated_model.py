"""An articulated model: parts joined by screws, with the surfaces that they carry."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import Array, move_screw, prismatic_motion, revolute_motion

FIXED, REVOLUTE, PRISMATIC = 0, 1, 2
Tiling = Literal["repeat", "mirror", "clamp"]


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
    """What a surface looks like (metallic-roughness, as glTF 2.0)."""

    name: str = ""
    base_color: tuple[float, float, float, float] = (0.5, 0.5, 0.5, 1.0)
    """Linear RGBA in 0..1 (not sRGB); multiplies the texture."""
    metallic: float = 0.0
    roughness: float = 0.6
    texture: NDArray[np.uint8] | None = None
    """[h w 3|4] sRGB, row 0 is the top of the image (v = 1)."""
    maps: Maps = Maps()
    tiling: tuple[Tiling, Tiling] = ("repeat", "repeat")
    """What the textures do beyond u and v of 0..1."""
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Linear RGB that the surface shines by itself."""
    unlit: bool = False
    """Whether it shows its base colour, whatever the light."""
    alpha_cutoff: float | None = None
    """There is no surface, neither colour nor depth, where alpha (the base colour's, texture's and
    vertex colour's product) is less."""
    blend: bool = False
    """Whether alpha of texture and vertex colours lets what is behind shine through; that of the
    base colour always does."""

    @property
    def transparent(self) -> bool:
        return self.blend or self.base_color[3] < 1.0


@dataclass(frozen=True)
class Skin:
    """How vertices follow several parts: linear blend skinning (glTF 2.0, section 3.7.3.1)."""

    bone_part: NDArray[np.int64]
    """[B] index of the part that is each bone."""
    part_from_mesh: Array
    """[B 4 4] affine: a vertex as stored to the bone's part frame (inverse bind, scale baked)."""
    bone: NDArray[np.int64]
    """[V K] index into the bones."""
    weight: Array
    """[V K], rows sum to 1."""


@dataclass(frozen=True)
class Morph:
    """Displacements of vertices, each scaled by a weight of the model (glTF morph targets)."""

    channel: NDArray[np.int64]
    """[M] index into the model's morph weights."""
    displacement: Array
    """[M V 3] m, in the frame of the stored vertices; added before the skin."""
    normal_displacement: Array | None
    """[M V 3]"""


@dataclass(frozen=True)
class Visual:
    """The triangles of one part that share a material."""

    part: int
    """Index into the model's parts (0-based): the one that masks show for these triangles. Of a
    skin, a visual has the triangles that follow one part most."""
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
        """Whether its vertices move otherwise than its part."""
        return self.skin is not None or self.morph is not None


@dataclass(frozen=True)
class ModelState:
    """Where the parts of a model are over time, and how its surfaces are stretched. T instants."""

    world_from_part: Array
    """[T P 4 4] rigid"""
    stretch: Array | None
    """[T P 4 4] affine, what a part's own frame suffers before its pose (animated scale), applied
    by skins only; None: nothing."""
    morph: Array
    """[T M] weights of the morph channels."""


class Animation(Protocol):
    """A motion that comes with a model."""

    @property
    def name(self) -> str: ...
    @property
    def duration(self) -> float:
        """s"""
        ...
    def at(self, times: Array) -> ModelState:
        """The posture at times [T] s, held before the first key and after the last."""
        ...


@dataclass(frozen=True)
class ArticulatedModel:
    """A kinematic tree as a struct of arrays; P parts, J independent joints.

    A part is a link (rigid body), in an order where parents stand before their children. Frames
    are the links' own. Part p moves against its parent by its own joint, which is driven by the
    independent joint `joint[p]`: a mimic joint is a part whose joint is another part's, with
    multiplier and offset, resolved transitively.
    """

    name: str
    part_names: tuple[str, ...]
    parent: NDArray[np.int64]
    """[P] index of the parent part, -1 for the root."""
    parent_from_part_at_zero: Array
    """[P 4 4] pose in the parent at joint value zero (of the part's own joint)."""
    motion: NDArray[np.int64]
    """[P] FIXED, REVOLUTE or PRISMATIC."""
    screw: Array
    """[P 6] axis of the part's own joint in the part's frame (l, m = p x l); prismatic: (l, 0)."""
    joint: NDArray[np.int64]
    """[P] the independent joint that drives the part, -1 where fixed."""
    multiplier: Array
    """[P] the part's own joint value is multiplier * position[joint] + offset."""
    offset: Array
    """[P] rad or m."""
    joint_names: tuple[str, ...]
    joint_child: NDArray[np.int64]
    """[J] the part that each independent joint moves against its parent: multiplier 1, offset 0."""
    joint_types: tuple[str, ...]
    """[J] "revolute", "continuous" or "prismatic"."""
    limits: Array
    """[J 2] rad or m; -inf, inf where a joint has none."""
    visuals: tuple[Visual, ...]
    animations: tuple[Animation, ...] = ()
    morph_weights: Array = field(default_factory=lambda: np.zeros(0))
    """[M] at rest; M morph channels."""
    keypoint_names: tuple[str, ...] = ()
    keypoint_part: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """[K] index of the part that carries each keypoint."""
    keypoint: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """[K 3] m, in that part's frame."""
    source: str = ""
    """Where the model came from: a catalogue name or a file name."""
    licence: str = ""
    sha256: str = ""
    """Of the model's file, hexadecimal; empty for a generated model."""
    notes: tuple[str, ...] = field(default=())
    """What the reader had to decide (frozen joints, missing meshes), one line each."""

    def subtree(self, part: int) -> NDArray[np.bool_]:
        """[P] whether each part is `part` or hangs on it."""
        inside = np.zeros(len(self.parent), bool)
        inside[part] = True
        for p in range(part + 1, len(self.parent)):
            inside[p] = self.parent[p] >= 0 and inside[self.parent[p]]
        return inside


def forward_kinematics(model: ArticulatedModel, positions: ArrayLike) -> Array:
    """world_from_part [... P 4 4] for joint positions [... J]; the world is the root's frame."""
    q = np.asarray(positions, np.float64)
    n_parts = len(model.parent)
    poses = np.zeros((*q.shape[:-1], n_parts, 4, 4))
    for p in range(n_parts):
        local = np.broadcast_to(model.parent_from_part_at_zero[p], (*q.shape[:-1], 4, 4))
        if model.motion[p] != FIXED:
            value = model.multiplier[p] * q[..., model.joint[p]] + model.offset[p]
            move = revolute_motion if model.motion[p] == REVOLUTE else prismatic_motion
            local = local @ move(np.broadcast_to(model.screw[p], (*q.shape[:-1], 6)), value)
        parent = model.parent[p]
        poses[..., p, :, :] = local if parent < 0 else poses[..., parent, :, :] @ local
    return poses


def joint_screws(model: ArticulatedModel, frame_from_part: ArrayLike) -> Array:
    """Axis [... J 6] of each independent joint in a frame, from part poses [... P 4 4] in it.

    A revolute axis is (l, m = p x l); a prismatic one its direction and zeros.
    """
    child = model.joint_child
    poses = np.asarray(frame_from_part, np.float64)[..., child, :, :]
    return move_screw(poses, model.screw[child], model.motion[child] == PRISMATIC)
