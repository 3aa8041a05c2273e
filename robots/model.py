"""An articulated model: parts joined by screws, with the surfaces that they carry."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import GcbenchError
from .geometry import Array, move_screw, prismatic_motion, revolute_motion

FIXED, REVOLUTE, PRISMATIC = 0, 1, 2


class ModelError(GcbenchError):
    """A model's file cannot be used; the message names the file, the reason and the remedy."""


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


@dataclass(frozen=True)
class Visual:
    """The triangles of one part that share a material."""

    part: int
    """Index into the model's parts (0-based)."""
    vertices: Array
    """[V 3] m, in the part's frame."""
    faces: NDArray[np.int32]
    """[F 3] counter-clockwise from outside."""
    normals: Array
    """[V 3] unit."""
    uv: Array | None
    """[V 2], (0, 0) at the bottom left as in OpenGL and OBJ; None where the mesh has none."""
    material: Material


@dataclass(frozen=True)
class ArticulatedModel:
    """A kinematic tree as a struct of arrays; P parts, J independent joints.

    A part is a link (rigid body), in an order where parents stand before their children. Frames
    are the links' own. Part p moves against its parent by its own joint, which is driven by the
    independent joint `joint[p]`: a mimic joint is a part whose joint is another part's, with gear
    and offset, resolved transitively.
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
    gear: Array
    """[P] the part's own joint value is gear * position[joint] + offset."""
    offset: Array
    """[P] rad or m."""
    joint_names: tuple[str, ...]
    joint_child: NDArray[np.int64]
    """[J] the part that each independent joint moves against its parent, with gear 1, offset 0."""
    joint_types: tuple[str, ...]
    """[J] "revolute", "continuous" or "prismatic"."""
    limits: Array
    """[J 2] rad or m; -inf, inf where a joint has none."""
    visuals: tuple[Visual, ...]
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
            value = model.gear[p] * q[..., model.joint[p]] + model.offset[p]
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
