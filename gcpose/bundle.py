"""Bundle adjustment (Sec. 3.4) with depth: joint displacements of many frames and unknown axes.

The paper minimises the distance between where a part's points fall under T_theta and where the
images show them (L_w, L_b). With depth that distance is point-to-plane; the unknowns are the
displacements theta_{1:n} of all joints and, where the knowledge leaves them open, the axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array
from .alignment import align, normal_equations, robust_weight
from .chain import angle_derivatives, axis_basis, axis_derivatives, displace_axis, part_motions
from .surface import Surfaces

_STEP = 0.15  # largest change of an unknown in an iteration, rad or m
_ACCELERATION = np.radians(2.0)  # prior: change of a joint's step from frame to frame, rad or m


@dataclass(frozen=True)
class Articulation:
    """A hypothesis about the object: J joints, T frames, all since frame 0 in the camera frame."""

    twist: Array
    """[J 6] (see chain.py)"""
    angle: Array
    """[T J] displacement, rad or m; row 0 is 0."""
    prismatic: NDArray[np.bool_]
    """[J]"""

    def motions(self, frames: int) -> Array:
        """[frames J+1 4 4] of the first frames."""
        return part_motions(self.twist, self.angle[:frames])


@dataclass(frozen=True)
class Normal:
    """Normal equations of an articulation: unknowns are k*J displacements, then the axes'."""

    matrix: Array
    vector: Array


def assemble(
    surfaces: Surfaces,
    points: Array,
    label: NDArray[np.int64],
    state: Articulation,
    basis: tuple[Array, ...],
    last: int,
    scale: Array,
) -> Normal:
    """Frames 1..last of the points [N 3] of frame 0 with part labels [N]; scale [N] m."""
    motion = state.motions(last + 1)
    by_angle = angle_derivatives(state.twist, motion)
    by_axis = axis_derivatives(motion, basis)
    joints, axes = state.twist.shape[0], by_axis.shape[-1]
    size = last * joints + axes
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    frames = np.arange(1, last + 1)
    for j in range(1, joints + 1):
        mine = label == j
        if np.count_nonzero(mine) < 6:
            continue
        a = align(surfaces, frames, motion[1:, j], points[mine])
        weight = np.where(a.hit, robust_weight(a.plane, scale[mine]), 0.0)
        six, right = normal_equations(a.row, a.plane, weight)
        g = np.concatenate([by_angle[1:, j], by_axis[1:, j]], axis=2)
        block = g.swapaxes(1, 2) @ six @ g
        side = np.einsum("tij,ti->tj", g, right)
        for t in range(last):
            index = np.r_[t * joints : (t + 1) * joints, last * joints : size]
            matrix[np.ix_(index, index)] += block[t]
            vector[index] += side[t]
    return Normal(matrix, vector)


def smoothness(angle: Array, last: int) -> Normal:
    """Prior on the displacements of frames 1..last: joints do not jerk."""
    joints = angle.shape[1]
    size = last * joints
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    for t in range(1, last):  # angle[t+1] - 2 angle[t] + angle[t-1], angle[0] = 0
        row = np.zeros(last)
        row[t], row[t - 1] = 1.0, -2.0
        if t > 1:
            row[t - 2] = 1.0
        part = np.kron(np.outer(row, row), np.eye(joints))
        matrix += part
        vector -= part @ angle[1 : last + 1].reshape(-1)
    return Normal(matrix / _ACCELERATION**2, vector / _ACCELERATION**2)


def adjust(
    surfaces: Surfaces,
    points: Array,
    label: NDArray[np.int64],
    state: Articulation,
    freedom: int,
    last: int,
    scales: tuple[float, ...],
) -> tuple[Articulation, Array]:
    """Gauss-Newton over frames 1..last, an iteration for each of `scales` (footprints).

    Returns the articulation and the Hessian of the last iteration.
    """
    joints = len(state.twist)
    footprint = surfaces.footprint(points[:, 2])
    hessian = np.zeros((0, 0))
    for scale in scales:
        basis = axis_bases(state, points, label, freedom)
        n = assemble(surfaces, points, label, state, basis, last, scale * footprint)
        prior = smoothness(state.angle, last)
        held = last * joints
        n.matrix[:held, :held] += prior.matrix
        n.vector[:held] += prior.vector
        hessian = n.matrix
        damped = n.matrix + np.diag(1e-4 * np.diag(n.matrix) + 1.0)
        damped[held:, held:] += np.eye(len(damped) - held) * 1e4
        step = np.clip(np.linalg.solve(damped, n.vector), -_STEP, _STEP)
        angle = state.angle.copy()
        angle[1 : last + 1] += step[:held].reshape(last, joints)
        state = replace(state, angle=angle, twist=displaced(state, basis, step[held:]))
        if np.abs(step).max() < 1e-6:
            break
    return state, hessian


def axis_bases(
    state: Articulation, points: Array, label: NDArray[np.int64], freedom: int
) -> tuple[Array, ...]:
    """A basis of displacements for each joint's axis."""
    middle = points[label > 0].mean(axis=0) if (label > 0).any() else np.zeros(3)
    out: list[Array] = []
    for j, (twist, prismatic) in enumerate(zip(state.twist, state.prismatic, strict=True)):
        mine = points[label == j + 1]
        near = mine.mean(axis=0) if len(mine) else middle
        out.append(axis_basis(twist, bool(prismatic), near, freedom))
    return tuple(out)


def displaced(state: Articulation, basis: tuple[Array, ...], step: Array) -> Array:
    """Twists [J 6] after a step along the bases."""
    twist, at = state.twist.copy(), 0
    for j, b in enumerate(basis):
        if b.shape[1]:
            by = b @ step[at : at + b.shape[1]]
            twist[j] = displace_axis(state.twist[j], by, bool(state.prismatic[j]))
        at += b.shape[1]
    return twist
