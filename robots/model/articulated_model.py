"""The articulated model: parts, screw axes and the surfaces of the parts, as arrays."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import Array, move_screw
from .links import JointType, Link, Mimic, resolve_mimics, shared_limits, sort_links
from .skinning import deform_visual
from .surface import visuals_of_part
from .visuals import Visual

_FIXED = JointType.FIXED

@dataclass(frozen=True, eq=False)
class ModelState:
    """Poses of the parts of a model and deformation of its surfaces at T instants."""

    world_from_part: Array
    """[T P 4 4] rigid"""
    stretch: Array | None
    """[T P 4 4] affine map in a part's frame before its pose (animated scale), for skins only;
    None: identity."""
    morph: Array
    """[T M] weights of the morph channels."""


class Animation(Protocol):
    """A motion stored in a model file."""

    @property
    def name(self) -> str: ...
    @property
    def duration(self) -> float:
        """s"""
        ...
    def at(self, times: Array) -> ModelState:
        """Return the state at times [T] s, constant before the first key and after the last."""
        ...


@dataclass(frozen=True, eq=False)
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
    part_joint_types: tuple[JointType, ...]
    """[P] type of the part's own joint."""
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
    limits: Array
    """[J 2] rad or m, of the joint and of those that mimic it; -inf, inf where there are none."""
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
    files: Mapping[str, str] = field(default_factory=dict[str, str])
    """SHA-256 of each file that was read, by its path from the folder of the model's file."""
    notes: tuple[str, ...] = field(default=())
    """Decisions of the reader (frozen joints, missing meshes), one line each."""

    def __repr__(self) -> str:
        counts = {"part": len(self.part_names), "joint": len(self.joint_names)}
        words = [f"{count} {word}{'s' * (count != 1)}" for word, count in counts.items()]
        return f"ArticulatedModel({reprlib.repr(self.name)}, {', '.join(words)})"

    @classmethod
    def from_links(
        cls, name: str, links: Sequence[Link], keep_order: bool = False
    ) -> ArticulatedModel:
        """Build a model from its links.

        Parts are sorted depth first from the root, siblings in the order of `links`; independent
        joints stand in the order of `links`. Mimics are resolved through chains; a mimic joint
        that nothing moves becomes fixed at its offset, which `notes` record. A joint stays within
        the limits of those that mimic it. The surfaces of a link become visuals, those of equal
        material joined.

        Args:
            name: Name of the model.
            links: The links, one of them without a parent.
            keep_order: Keep the order of `links`, in which parents stand before children.

        Raises:
            ModelError: If the links do not make one tree, or a name, mimic or axis is invalid.
        """
        parts = sort_links(links, keep_order)
        index = {link.name: p for p, link in enumerate(parts)}
        joints = [link.joint for link in parts]
        free = [link for link in links if link.joint.type is not _FIXED and not link.joint.mimic]
        number = {link.joint.name: j for j, link in enumerate(free)}
        mimics = resolve_mimics([link.joint for link in links])
        limits, ignored = shared_limits([link.joint for link in links], mimics)
        drivers = [mimics.get(joint.name, Mimic(joint.name)) for joint in joints]
        moves = np.array([joint.type is not _FIXED and driver.multiplier != 0.0
                          and driver.joint in number
                          for joint, driver in zip(joints, drivers, strict=True)], bool)
        at_zero = np.array([link.parent_from_link_at_zero for link in parts], np.float64)
        screw = np.array([joint.screw for joint in joints])
        frozen = [p for p in np.flatnonzero(~moves) if joints[p].type is not _FIXED]
        for p in frozen:
            at_zero[p] = at_zero[p] @ joints[p].type.motion(screw[p], drivers[p].offset)
        digests: dict[int, bytes] = {}
        return cls(
            name=name, part_names=tuple(index),
            parent=np.array([-1 if link.parent is None else index[link.parent] for link in parts],
                            np.int64),
            parent_from_part_at_zero=at_zero,
            part_joint_types=tuple(joint.type if m else _FIXED
                                   for joint, m in zip(joints, moves, strict=True)),
            screw=np.where(moves[:, None], screw, 0.0),
            joint=np.where(moves, [number.get(d.joint, -1) for d in drivers], -1),
            multiplier=np.where(moves, [d.multiplier for d in drivers], 1.0),
            offset=np.where(moves, [d.offset for d in drivers], 0.0),
            joint_names=tuple(number),
            joint_child=np.array([index[link.name] for link in free], np.int64),
            limits=np.array([limits[name] for name in number], np.float64).reshape(-1, 2),
            visuals=tuple(v for p, x in enumerate(parts)
                          for v in visuals_of_part(p, x.surfaces, digests)),
            notes=tuple(f"joint {joints[p].name!r} mimics {drivers[p].joint!r}, "
                        "which does not move it: frozen" for p in frozen) + ignored)

    @cached_property
    def joint_types(self) -> tuple[JointType, ...]:
        """[J] of the independent joints."""
        return tuple(self.part_joint_types[child] for child in self.joint_child)

    @cached_property
    def prismatic(self) -> NDArray[np.bool_]:
        """[P] whether the part's own joint is prismatic."""
        return np.array([t is JointType.PRISMATIC for t in self.part_joint_types], bool)

    def subtree(self, part: int) -> NDArray[np.bool_]:
        """Return for each part [P] whether it is `part` or a descendant of it."""
        inside = np.zeros(len(self.parent), bool)
        inside[part] = True
        for p in range(part + 1, len(self.parent)):
            inside[p] = self.parent[p] >= 0 and inside[self.parent[p]]
        return inside


def forward_kinematics(model: ArticulatedModel, positions: ArrayLike) -> Array:
    """Return world_from_part [... P 4 4] for joint positions [... J] rad or m.

    The world is the frame of the root.
    """
    q = np.asarray(positions, np.float64)
    local = np.broadcast_to(model.parent_from_part_at_zero,
                            (*q.shape[:-1], len(model.parent), 4, 4)).copy()
    for kind in {*model.part_joint_types} - {_FIXED}:
        p = np.flatnonzero([t is kind for t in model.part_joint_types])
        value = model.multiplier[p] * q[..., model.joint[p]] + model.offset[p]
        screw = np.broadcast_to(model.screw[p], (*value.shape, 6))
        local[..., p, :, :] = local[..., p, :, :] @ kind.motion(screw, value)
    for p, parent in enumerate(model.parent):
        if parent >= 0:  # which stands before, as a pose in the world
            local[..., p, :, :] = local[..., parent, :, :] @ local[..., p, :, :]
    return local


def rest_size(model: ArticulatedModel) -> float:
    """Return the diagonal, m, of the bounding box of a model with all joints at zero."""
    poses = forward_kinematics(model, np.zeros(len(model.joint_names)))
    points = [deform_visual(v, poses, None, model.morph_weights)[0] for v in model.visuals]
    low = np.min([p.min(0) for p in points], axis=0)
    high = np.max([p.max(0) for p in points], axis=0)
    return float(np.linalg.norm(high - low))


def scale_model(model: ArticulatedModel, factor: float) -> ArticulatedModel:
    """Return a model without skins and animations in which all lengths are `factor` times larger.
    """
    unit = np.where(model.prismatic, factor, 1.0)  # of the value of each part's own joint
    driver = np.where(model.joint >= 0, unit[model.joint_child][model.joint], 1.0) if len(
        model.joint_child) else 1.0
    pose, screw = model.parent_from_part_at_zero.copy(), model.screw.copy()
    pose[:, :3, 3] *= factor
    screw[:, 3:] *= factor
    return replace(
        model, parent_from_part_at_zero=pose, screw=screw, offset=model.offset * unit,
        multiplier=model.multiplier * unit / driver,
        limits=model.limits * unit[model.joint_child, None],
        visuals=tuple(replace(v, vertices=v.vertices * factor) for v in model.visuals))


def joint_screws(model: ArticulatedModel, frame_from_part: ArrayLike) -> Array:
    """Return the axis [... J 6] of each independent joint in the frame of part poses [... P 4 4].

    A revolute axis is (l, m = p x l); a prismatic one its direction and zeros.
    """
    child = model.joint_child
    poses = np.asarray(frame_from_part, np.float64)[..., child, :, :]
    return move_screw(poses, model.screw[child], model.prismatic[child])
