"""A hypothesis about the object: axes, displacements, and the parts of points.

The motion of a single part is ill-determined (a link is nearly a cylinder). In a chain each joint
has one unknown per frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from .kinematics import axis_basis, derivatives, displace_axis, part_motions


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


def axis_bases(
    state: Articulation, clouds: tuple[Cloud, ...], axis_dof: int
) -> tuple[Array, ...]:
    """Return a basis [6 d] of displacements of each joint's axis (see `axis_basis`)."""
    return tuple(
        axis_basis(twist, bool(prismatic), near, axis_dof)
        for twist, prismatic, near in zip(
            state.twist, state.prismatic, part_centers(clouds[0], len(state.twist)), strict=True)
    )


def part_centers(cloud: Cloud, joints: int) -> Array:
    """Return the mean point [J 3] of each joint's part; where it is hidden, that of all parts."""
    points, label = cloud.point, cloud.label
    middle = points[label > 0].mean(axis=0) if (label > 0).any() else np.zeros(3)
    mine = [points[label == j + 1] for j in range(joints)]
    return np.stack([m.mean(axis=0) if len(m) else middle for m in mine])


def displace_axes(state: Articulation, basis: tuple[Array, ...], step: Array) -> Array:
    """Return the axes [J 6] after a step along their bases."""
    twist, at = state.twist.copy(), 0
    for j, b in enumerate(basis):
        if b.shape[1]:
            by = b @ step[at : at + b.shape[1]]
            twist[j] = displace_axis(state.twist[j], by, bool(state.prismatic[j]))
        at += b.shape[1]
    return twist


def select_by_labels(found: list[Hypothesis], most: int, difference: float) -> list[Hypothesis]:
    """Return the `most` best whose labels differ in more than a share of the points of frame 0."""
    out: list[Hypothesis] = []
    for h in sorted(found, key=lambda h: h.cost):
        if all(np.mean(h.clouds[0].label != other.clouds[0].label) > difference for other in out):
            out.append(h)
        if len(out) == most:
            break
    return out
