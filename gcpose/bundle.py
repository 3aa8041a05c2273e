"""Bundle adjustment (Sec. 3.4) with depth: joint displacements of many frames and unknown axes.

The paper minimises the distance between where a part's points fall under T_theta and where the
images show them (L_w, L_b). With depth that distance is point-to-plane; the unknowns are the
displacements theta_{1:n} of all joints and, where the knowledge leaves them open, the axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array, inverse
from .alignment import (
    align,
    flow_residuals,
    normal_equations,
    robust_weight,
    shade_residuals,
)
from .chain import (
    adjoint,
    angle_derivatives,
    axis_basis,
    axis_derivatives,
    cross_matrix,
    displace_axis,
    part_motions,
)
from .surface import Surfaces

_STEP = 0.15  # largest change of an unknown in an iteration, rad or m
_FLOW_SCALE = 1.0  # px, of flow's errors
_FLOW_SHARE = 0.05  # of its pixels that err independently
_SHADE_SCALE = 6.0  # of 255
_SHADE_SHARE = 0.2
_ACCELERATION = np.radians(0.6)  # prior: change of a joint's step from frame to frame, rad or m


FREE, ACROSS, ALONG = 0, 1, 2
"""Two neighbouring axes: anyhow, at right angles, parallel (as machines are built)."""
_SQUARE = np.radians(0.5)  # how exactly they are built so


@dataclass(frozen=True)
class Articulation:
    """A hypothesis about the object: J joints, T frames, all since frame 0 in the camera frame."""

    twist: Array
    """[J 6] (see chain.py)"""
    angle: Array
    """[T J] displacement, rad or m; row 0 is 0."""
    prismatic: NDArray[np.bool_]
    """[J]"""
    relation: tuple[int, ...] = ()
    """[J-1] how joint i's axis lies to the next: FREE, ACROSS or ALONG; empty: all free."""

    def motions(self, frames: int) -> Array:
        """[frames J+1 4 4] of the first frames."""
        return part_motions(self.twist, self.angle[:frames])


@dataclass(frozen=True)
class Normal:
    """Normal equations of an articulation: unknowns are k*J displacements, then the axes'."""

    matrix: Array
    vector: Array
    scatter: Array | None = None
    """Sum of the outer products of each cloud's, part's and frame's vector: the covariance of
    `vector` if what errs errs together there."""


@dataclass(frozen=True)
class Cloud:
    """Points that a frame sees, with their parts: a piece of the paper's point cloud model."""

    frame: int
    point: Array
    """[N 3] at that frame, camera frame, m"""
    normal: Array
    """[N 3]"""
    shade: Array
    """[N] brightness"""
    label: NDArray[np.int64]
    """[N] 0..J"""


def assemble(
    surfaces: Surfaces,
    clouds: tuple[Cloud, ...],
    state: Articulation,
    basis: tuple[Array, ...],
    last: int,
    scale: float,
    fine: bool,
) -> Normal:
    """Clouds against all frames up to `last`; `scale` is in footprints of a pixel.

    A point of frame s is at T_t T_s^-1 X in frame t: both frames' unknowns move it.
    """
    motion = state.motions(last + 1)
    derivative = derivatives(state, motion, basis)
    size = derivative.shape[-1]
    matrix, vector, scatter = np.zeros((size, size)), np.zeros(size), np.zeros((size, size))
    for cloud in clouds:
        frames = np.delete(np.arange(last + 1), cloud.frame)
        for j in range(1, len(state.twist) + 1):
            mine = cloud.label == j
            if np.count_nonzero(mine) < 6:
                continue
            here_from_there = motion[frames, j] @ inverse(motion[cloud.frame, j])
            point = cloud.point[mine]
            a = align(surfaces, frames, here_from_there, point, cloud.normal[mine])
            sigma = scale * (surfaces.footprint(point[:, 2]) + surfaces.noise)
            weight = np.where(a.hit, robust_weight(a.plane, sigma), 0.0)
            six, right = normal_equations(a.row, a.plane, weight)
            g = derivative[frames, j]
            if cloud.frame:
                g = g - adjoint(here_from_there) @ derivative[cloud.frame, j]
            matrix += np.tensordot(g, six @ g, axes=((0, 1), (0, 1)))
            each = np.einsum("ti,tiu->tu", right, g)
            vector += each.sum(axis=0)
            scatter += each.T @ each
            if surfaces.shade is not None and fine:
                residual, row, seen = shade_residuals(
                    surfaces, frames, here_from_there, point, cloud.shade[mine]
                )
                weight = np.where(seen, robust_weight(residual, _SHADE_SCALE), 0.0) * _SHADE_SHARE
                six, right = normal_equations(row, residual, weight.astype(np.float32))
                g = derivative[frames, j]
                if cloud.frame:
                    g = g - adjoint(here_from_there) @ derivative[cloud.frame, j]
                matrix += np.tensordot(g, six @ g, axes=((0, 1), (0, 1)))
                each = np.einsum("ti,tiu->tu", right, g)
                vector += each.sum(axis=0)
                scatter += each.T @ each
            elif surfaces.flow is not None:
                steps = np.arange(last)
                there = motion[:, j] @ inverse(motion[cloud.frame, j])
                residual, row, seen = flow_residuals(surfaces, steps, there[:-1], there[1:], point)
                weight = np.where(seen, robust_weight(residual, _FLOW_SCALE), 0.0) * _FLOW_SHARE
                six, right = normal_equations(row, residual, weight.astype(np.float32))
                step = motion[1:, j] @ inverse(motion[:-1, j])
                g = derivative[1:, j] - adjoint(step) @ derivative[:-1, j]
                matrix += np.tensordot(g, six @ g, axes=((0, 1), (0, 1)))
                each = np.einsum("ti,tiu->tu", right, g)
                vector += each.sum(axis=0)
                scatter += each.T @ each
    return Normal(matrix, vector, scatter)


def derivatives(state: Articulation, motion: Array, basis: tuple[Array, ...]) -> Array:
    """[T J+1 6 U] twists of the parts per unknown: displacements of frames 1.., then axes."""
    frames, joints = len(motion), len(state.twist)
    by_angle = angle_derivatives(state.twist, motion)
    by_axis = axis_derivatives(motion, basis)
    held = (frames - 1) * joints
    out = np.zeros((frames, joints + 1, 6, held + by_axis.shape[-1]))
    for t in range(1, frames):
        out[t, ..., (t - 1) * joints : t * joints] = by_angle[t]
    out[..., held:] = by_axis
    return out


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


@dataclass(frozen=True)
class Hinges:
    """Where joints are believed to be: an axis passes near where its part begins."""

    point: Array
    """[J 3] m"""
    slack: float
    """Standard deviation of the distance, m."""


def closeness(state: Articulation, basis: tuple[Array, ...], hinges: Hinges) -> Normal:
    """Prior on the axes' unknowns: a hinge should stay where it is when its joint turns."""
    sizes = [b.shape[1] for b in basis]
    matrix, vector = np.zeros((sum(sizes), sum(sizes))), np.zeros(sum(sizes))
    at = 0
    for twist, b, point, prismatic in zip(
        state.twist, basis, hinges.point, state.prismatic, strict=True
    ):
        if b.shape[1] and not prismatic:
            l = twist[:3]
            foot = np.cross(l, twist[3:])
            offset = point - foot - l * (l @ (point - foot))  # from the axis to the hinge
            moved = b[3:, :2]  # the axis' slides; its turning hardly changes the distance
            here = slice(at, at + 2)
            matrix[here, here] += moved.T @ moved / hinges.slack**2
            vector[here] += moved.T @ offset / hinges.slack**2
        at += b.shape[1]
    return Normal(matrix, vector)


def squareness(state: Articulation, basis: tuple[Array, ...]) -> Normal:
    """Prior on the axes' unknowns: neighbouring axes lie as the hypothesis' relations say."""
    start = np.concatenate([[0], np.cumsum([b.shape[1] for b in basis])])
    matrix, vector = np.zeros((start[-1], start[-1])), np.zeros(start[-1])
    direction = np.where(state.prismatic[:, None], state.twist[:, 3:], state.twist[:, :3])
    for i, relation in enumerate(state.relation):
        a, b = direction[i], direction[i + 1]
        if relation == FREE:
            continue
        jacobian = np.zeros((3, start[-1]))
        one, two = slice(start[i], start[i + 1]), slice(start[i + 1], start[i + 2])
        if relation == ACROSS:
            residual = np.array([a @ b, 0.0, 0.0])
            jacobian[0, one] = np.cross(a, b) @ basis[i][:3]
            jacobian[0, two] = np.cross(b, a) @ basis[i + 1][:3]
        else:
            same = 1.0 if a @ b > 0 else -1.0
            residual = a - same * b
            jacobian[:, one] = -cross_matrix(a) @ basis[i][:3]
            jacobian[:, two] = same * cross_matrix(b) @ basis[i + 1][:3]
        matrix += jacobian.T @ jacobian / _SQUARE**2
        vector -= jacobian.T @ residual / _SQUARE**2
    return Normal(matrix, vector)


def adjust(
    surfaces: Surfaces,
    clouds: tuple[Cloud, ...],
    state: Articulation,
    freedom: int,
    scales: tuple[float, ...],
    hinges: Hinges,
    newest: bool = False,
    fine: bool = False,
) -> tuple[Articulation, Array]:
    """Gauss-Newton over the state's frames, an iteration for each of `scales` (footprints).

    With `newest` only the last frame's displacements move. Returns the articulation and the
    standard deviation of its displacements [T J].
    """
    joints, last = len(state.twist), len(state.angle) - 1
    held = last * joints
    hessian, scatter = np.zeros((0, 0)), np.zeros((0, 0))
    for scale in scales:
        basis = axis_bases(state, clouds, 0 if newest else freedom)
        n = assemble(surfaces, clouds, state, basis, last, scale, fine)
        prior = smoothness(state.angle, last)
        assert n.scatter is not None
        scatter = n.scatter.copy()
        scatter[:held, :held] += prior.matrix
        n.matrix[:held, :held] += prior.matrix
        n.vector[:held] += prior.vector
        for belief in (closeness(state, basis, hinges), squareness(state, basis)):
            n.matrix[held:, held:] += belief.matrix
            scatter[held:, held:] += belief.matrix
            n.vector[held:] += belief.vector
        hessian = n.matrix
        damping = 1e-4 * np.diag(n.matrix) + 1.0
        damping[held:] += 100.0
        if newest:
            damping[: held - joints] += 1e15
        step = np.linalg.solve(n.matrix + np.diag(damping), n.vector)
        step = np.clip(step, -_STEP, _STEP)
        angle = state.angle.copy()
        angle[1:] += step[:held].reshape(last, joints)
        state = replace(state, angle=angle, twist=displaced(state, basis, step[held:]))
        if np.abs(step).max() < 1e-6:
            break
    return state, deviation(hessian, scatter, last, joints)


def deviation(hessian: Array, scatter: Array, last: int, joints: int) -> Array:
    """[T J] of the displacements: H^-1 S H^-1, S the scatter of what pulls at them."""
    out = np.zeros((last + 1, joints))
    inverse_hessian = np.linalg.inv(hessian + 1e-6 * np.eye(len(hessian)))
    variance = np.diag(inverse_hessian @ scatter @ inverse_hessian)[: last * joints]
    out[1:] = np.sqrt(np.maximum(variance, 0.0)).reshape(last, joints)
    return out


def axis_bases(
    state: Articulation, clouds: tuple[Cloud, ...], freedom: int
) -> tuple[Array, ...]:
    """A basis of displacements for each joint's axis."""
    points, label = clouds[0].point, clouds[0].label
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
