"""Axes and displacements of a chain.

The motion of a single part is ill-determined (a link is nearly a cylinder). In a chain each joint
has one unknown per frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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

    @property
    def directions(self) -> Array:
        """[J 3] of turns and slides"""
        return np.where(self.prismatic[:, None], self.twist[:, 3:], self.twist[:, :3])

    def motions(self, frames: int) -> Array:
        """Return the motions [frames J+1 4 4] of all parts in the first frames."""
        return part_motions(self.twist, self.angle[:frames], self.parent)

    def derivatives(self, motion: Array, basis: tuple[Array, ...]) -> Array:
        """Return twists [T J+1 U 6] of the parts per displacement of frames 1.., then per axis."""
        return derivatives(self.twist, motion, self.parent, basis)


def axis_bases(state: Articulation, near: Array, axis_dof: int) -> tuple[Array, ...]:
    """Return a basis [6 d] of displacements of each joint's axis by points near [J 3] (see
    `axis_basis`)."""
    return tuple(axis_basis(twist, bool(prismatic), point, axis_dof) for twist, prismatic, point
                 in zip(state.twist, state.prismatic, near, strict=True))


def take_step(state: Articulation, basis: tuple[Array, ...], step: Array) -> Articulation:
    """Return the articulation after a step [U] of its displacements of frames 1.. and of its axes
    along their bases."""
    angle, twist, at = state.angle.copy(), state.twist.copy(), state.angle[1:].size
    angle[1:] += step[:at].reshape(angle[1:].shape)
    by = np.zeros_like(twist)
    for j, b in enumerate(basis):
        by[j] = b @ step[at : at + b.shape[1]]
        at += b.shape[1]
    for prismatic in (False, True):
        mine = (state.prismatic == prismatic) & by.any(axis=1)
        if mine.any():
            twist[mine] = displace_axis(twist[mine], by[mine], prismatic)
    return replace(state, angle=angle, twist=twist)


def extrapolate_to(state: Articulation, until: int, steps: int = 1) -> Articulation:
    """Return the articulation up to frame `until`, extrapolated at the mean pace of its last
    `steps` steps, or cut."""
    angle = state.angle[: until + 1]
    steps = min(steps, len(angle) - 1)
    pace = (angle[-1] - angle[-1 - steps]) / steps
    further = angle[-1] + np.arange(1, until + 2 - len(angle))[:, None] * pace
    return replace(state, angle=np.concatenate([angle, further]))
