"""Chains fitted to what parts do, many at once (Sec. 3.3): it takes no image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, inverse
from .kinematics import adjoint, axis_basis, carriers, displace_axis, logarithm, part_motions
from .settings import ChainSettings


@dataclass(frozen=True)
class Goal:
    """What G parts do, whatever makes them do it, and the I joints that are to make them do it."""

    path: NDArray[np.int64]
    """[I] of all joints, from the base outward"""
    parent: NDArray[np.int64]
    """[I] which of these carries each (see chain.py)"""
    place: NDArray[np.int64]
    """[G] which of these moves each part last"""
    motion: Array
    """[T G 4 4]"""
    information: Array
    """[T G 6 6] of the twists on their left"""

    @property
    def moves(self) -> NDArray[np.bool_]:
        """[G I] which joints move each part"""
        return carriers(self.parent)[self.place + 1]


def follow_held(goal: Goal, twist: Array, settings: ChainSettings) -> Array:
    """Displacements [S T I] of chains [S I 6] whose axes are held, nearest to the goal."""
    joints = twist.shape[1]
    angle = np.zeros((len(twist), len(goal.motion), joints))
    for _ in range(settings.fit_held_iterations):
        motion, error = errors(goal, twist, angle)
        row = by_displacement(goal, twist, motion)
        weighted = goal.information @ row
        matrix = np.einsum("stgki,stgkj->stij", row, weighted, optimize=True)
        size = np.trace(matrix, axis1=2, axis2=3)[..., None, None] / joints
        matrix += (settings.fit_held_damping * size + 1e-6) * np.eye(joints)
        vector = np.einsum("stgki,stgk->sti", weighted, error, optimize=True)
        step = np.linalg.solve(matrix, vector[..., None])[..., 0]
        angle += np.clip(step, -settings.fit_max_step, settings.fit_max_step)
        angle[:, 0] = 0.0
    return angle


def fit_chains(
    goal: Goal, twist: Array, angle: Array, prismatic: NDArray[np.bool_], near: Array,
    freedom: int, settings: ChainSettings,
) -> tuple[Array, Array, Array]:
    """Gauss-Newton on displacements [S T I] and axes [S I 6]; and the misfit [S].

    `near` [I 3] and freedom as in `axis_basis`.
    """
    chains, frames, joints = angle.shape
    held, moves = (frames - 1) * joints, goal.moves
    for _ in range(settings.fit_iterations):
        motion, error = errors(goal, twist, angle)
        ad = adjoint(motion)
        bases = [axis_basis(twist[:, j], bool(prismatic[j]), near[j], freedom)
                 for j in range(joints)]
        row = np.zeros((*error.shape, held + sum(b.shape[2] for b in bases)))
        each, at = by_displacement(goal, twist, motion), held
        for t in range(1, frames):
            row[:, t, ..., (t - 1) * joints : t * joints] = each[:, t]
        for j, b in enumerate(bases):
            turned = (ad[:, :, goal.parent[j] + 1] - ad[:, :, j + 1]) @ b[:, None]
            row[..., at : at + b.shape[2]] = turned[:, :, None] * moves[:, j, None, None]
            at += b.shape[2]
        square = np.einsum("stgi,tgij,stgj->stg", error, goal.information, error)
        median = np.median(square[:, 1:], axis=1, keepdims=True)
        typical = np.maximum(1e-12, settings.fit_robust_scale * median)
        trust = 1.0 / (1.0 + square / typical)
        weighted = (goal.information * trust[..., None, None]) @ row
        flat = weighted.reshape(chains, -1, row.shape[-1]).swapaxes(1, 2)
        matrix = flat @ row.reshape(chains, -1, row.shape[-1])
        diagonal = np.arange(matrix.shape[1])
        matrix[:, diagonal, diagonal] *= 1 + settings.fit_damping
        matrix[:, diagonal, diagonal] += 1e-9
        step = np.linalg.solve(matrix, flat @ error.reshape(chains, -1, 1))[..., 0]
        step = np.clip(step, -settings.fit_max_step, settings.fit_max_step)
        angle = angle.copy()
        angle[:, 1:] += step[:, :held].reshape(chains, frames - 1, joints)
        twist, at = twist.copy(), held
        for j, b in enumerate(bases):
            if b.shape[2]:
                by = (b @ step[:, at : at + b.shape[2], None])[..., 0]
                twist[:, j] = displace_axis(twist[:, j], by, bool(prismatic[j]))
            at += b.shape[2]
    return twist, angle, misfit(goal, twist, angle)


def by_displacement(goal: Goal, twist: Array, motion: Array) -> Array:
    """[S T G 6 I] twists of the goal's parts per displacement, for chains [S I 6] and their
    motion."""
    each = adjoint(motion[:, :, goal.parent + 1]) @ twist[:, None, :, :, None]
    return each[:, :, None, :, :, 0].swapaxes(-1, -2) * goal.moves[:, None, :]


def errors(goal: Goal, twist: Array, angle: Array) -> tuple[Array, Array]:
    """Motions [S T I+1 4 4] of chains, and the twists [S T G 6] that the goal's parts lack."""
    motion = part_motions(twist, angle, goal.parent)
    return motion, logarithm(goal.motion @ inverse(motion[:, :, goal.place + 1]))


def misfit(goal: Goal, twist: Array, angle: Array) -> Array:
    """[S] how badly chains reach the goal."""
    _, error = errors(goal, twist, angle)
    square = np.einsum("stgi,tgij,stgj->stg", error, goal.information, error)
    return np.sqrt(np.maximum(square, 0.0)).mean(axis=(1, 2))
