"""A hypothesis about the object: axes, displacements, and the parts of points.

The motion of a single part is ill-determined (a link is nearly a cylinder). In a chain each joint
has one unknown per frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from .kinematics import axis_basis, derivatives, displace_axis, part_motions

_H = TypeVar("_H")


@dataclass(frozen=True)
class Articulation:
    """J joints over T frames; motions are since frame 0, in the camera frame."""

    twist: Array
    """[J 6] axes (see kinematics.py)"""
    angle: Array
    """[T J] displacements, rad or m; row 0 is 0"""
    prismatic: NDArray[np.bool_]
    """[J]"""
    parent: NDArray[np.int64]
    """[J] joint before each, -1 for the base"""

    def motions(self, frames: int) -> Array:
        """Return the motions [frames J+1 4 4] of all parts in the first frames."""
        return part_motions(self.twist, self.angle[:frames], self.parent)

    def derivatives(self, motion: Array, basis: tuple[Array, ...]) -> Array:
        """Return twists [T J+1 U 6] of the parts per displacement of frames 1.., then per axis."""
        return derivatives(self.twist, motion, self.parent, basis)


@dataclass(frozen=True)
class Cloud:
    """Labelled points of one frame: a piece of the paper's point cloud model."""

    frame: int
    point: Array
    """[N 3] in that frame, camera frame, m"""
    normal: Array
    """[N 3]"""
    label: NDArray[np.int64]
    """[N] 0..J"""


@dataclass(frozen=True)
class Hypothesis:
    """An articulation, its labels, and their cost."""

    state: Articulation
    clouds: tuple[Cloud, ...]
    """Of the key frames; the first is frame 0."""
    cost: float
    """Mean label cost of a point, variances by frame."""
    base: int = 0
    """Index of the candidate of the base point (see `rgbd.Tracker.base_candidates`)."""


def axis_bases(state: Articulation, near: Array, axis_dof: int) -> tuple[Array, ...]:
    """Return a basis [6 d] of displacements of each joint's axis by points near [J 3] (see
    `axis_basis`)."""
    return tuple(axis_basis(twist, bool(prismatic), point, axis_dof) for twist, prismatic, point
                 in zip(state.twist, state.prismatic, near, strict=True))


def part_centers(cloud: Cloud, joints: int) -> Array:
    """Return the mean point [J 3] of each joint's part; where it is hidden, that of all parts."""
    points, label = cloud.point, cloud.label
    middle = points[label > 0].mean(axis=0) if (label > 0).any() else np.zeros(3)
    mine = [points[label == j + 1] for j in range(joints)]
    return np.stack([m.mean(axis=0) if len(m) else middle for m in mine])


def take_step(state: Articulation, basis: tuple[Array, ...], step: Array) -> Articulation:
    """Return the articulation after a step [U] of its displacements of frames 1.. and of its axes
    along their bases."""
    angle, twist, at = state.angle.copy(), state.twist.copy(), state.angle[1:].size
    angle[1:] += step[:at].reshape(angle[1:].shape)
    for j, b in enumerate(basis):
        if b.shape[1]:
            by = b @ step[at : at + b.shape[1]]
            twist[j] = displace_axis(twist[j], by, bool(state.prismatic[j]))
        at += b.shape[1]
    return replace(state, angle=angle, twist=twist)


def select_distinct(
    found: list[_H], most: int, differ: Callable[[_H, _H], bool], key: Callable[[_H], float]
) -> list[_H]:
    """Return the `most` best by `key` of which any two differ."""
    out: list[_H] = []
    for h in sorted(found, key=key):
        if all(differ(h, other) for other in out):
            out.append(h)
        if len(out) == most:
            break
    return out


def select_by_labels(found: list[Hypothesis], most: int, difference: float) -> list[Hypothesis]:
    """Return the `most` best whose labels differ in more than a share of the points of frame 0."""
    def differ(one: Hypothesis, two: Hypothesis) -> bool:
        return bool(np.mean(one.clouds[0].label != two.clouds[0].label) > difference)

    return select_distinct(found, most, differ, lambda h: h.cost)
