"""A hypothesis about the object: its axes, their displacements, and which points are on which part.

A part's motion alone is ill-determined (a link is nearly a cylinder); under the chain each joint
has one unknown a frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from .kinematics import (
    axis_basis,
    derivatives,
    displace_axis,
    part_motions,
)


@dataclass(frozen=True)
class Articulation:
    """A hypothesis about the object: J joints, T frames, all since frame 0 in the camera frame."""

    twist: Array
    """[J 6] (see chain.py)"""
    angle: Array
    """[T J] displacement, rad or m; row 0 is 0."""
    prismatic: NDArray[np.bool_]
    """[J]"""
    parent: NDArray[np.int64]
    """[J] (see chain.py)"""

    def motions(self, frames: int) -> Array:
        """[frames J+1 4 4] of the first frames."""
        return part_motions(self.twist, self.angle[:frames], self.parent)

    def derivatives(self, motion: Array, basis: tuple[Array, ...]) -> Array:
        """[T J+1 U 6] of those motions per displacement of frames 1.., and per axis by a basis."""
        return derivatives(self.twist, motion, self.parent, basis)


@dataclass(frozen=True)
class Cloud:
    """Points that a frame sees, with their parts: a piece of the paper's point cloud model."""

    frame: int
    point: Array
    """[N 3] at that frame, camera frame, m"""
    normal: Array
    """[N 3]"""
    label: NDArray[np.int64]
    """[N] 0..J"""


@dataclass(frozen=True)
class Hypothesis:
    """An articulation, the parts that go with it, and how badly both explain the frames."""

    state: Articulation
    clouds: tuple[Cloud, ...]
    """Of the key frames; the first is frame 0."""
    cost: float
    order: int = 0
    """Which way from the base outward it takes (see Tracker)."""


def axis_bases(
    state: Articulation, clouds: tuple[Cloud, ...], freedom: int
) -> tuple[Array, ...]:
    """A basis of displacements for each joint's axis."""
    return tuple(
        axis_basis(twist, bool(prismatic), near, freedom)
        for twist, prismatic, near in zip(
            state.twist, state.prismatic, middles(clouds[0], len(state.twist)), strict=True)
    )


def middles(cloud: Cloud, joints: int) -> Array:
    """[J 3] of what each joint is the last to move; of all that moves where that is hidden."""
    points, label = cloud.point, cloud.label
    middle = points[label > 0].mean(axis=0) if (label > 0).any() else np.zeros(3)
    mine = [points[label == j + 1] for j in range(joints)]
    return np.stack([m.mean(axis=0) if len(m) else middle for m in mine])


def displaced(state: Articulation, basis: tuple[Array, ...], step: Array) -> Array:
    """Twists [J 6] after a step along the bases."""
    twist, at = state.twist.copy(), 0
    for j, b in enumerate(basis):
        if b.shape[1]:
            by = b @ step[at : at + b.shape[1]]
            twist[j] = displace_axis(state.twist[j], by, bool(state.prismatic[j]))
        at += b.shape[1]
    return twist


def distinct(found: list[Hypothesis], most: int, difference: float) -> list[Hypothesis]:
    """The `most` best whose labels differ in a share of the points of frame 0."""
    out: list[Hypothesis] = []
    for h in sorted(found, key=lambda h: h.cost):
        if all(np.mean(h.clouds[0].label != other.clouds[0].label) > difference for other in out):
            out.append(h)
        if len(out) == most:
            break
    return out
