"""Fit kinematic chains to given part motions, batched over chains (Sec. 3.3). Uses no images."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, inverse, se3
from ..numerics import Solver, cauchy_weight, gauss_newton
from .kinematics import ancestors, axis_basis, displace_axis, part_motions
from .settings import ChainSettings


@dataclass(frozen=True)
class Goal:
    """Motions of G parts, and the I joints that should make them."""

    path: NDArray[np.int64]
    """[I] of all joints, from the base outward"""
    parent: NDArray[np.int64]
    """[I] index in `path` of the joint before each, -1 for the base"""
    place: NDArray[np.int64]
    """[G] index in `path` of the joint that moves each part last"""
    motion: Array
    """[T G 4 4] since frame 0, camera frame"""
    information: Array
    """[T G 6 6] of the twists on their left"""
    prismatic: NDArray[np.bool_]
    """[I]"""
    near: Array
    """[I 3] a point of each joint's part, m"""
    axis_dof: int
    """Free parameters of a revolute axis (see `axis_basis`)."""

    @property
    def moves(self) -> NDArray[np.bool_]:
        """[G I] which joints move each part"""
        return ancestors(self.parent)[self.place + 1]


@dataclass(frozen=True)
class Chains:
    """S hypotheses about I joints over T frames."""

    twist: Array
    """[S I 6]"""
    angle: Array
    """[S T I] displacements, rad or m; those of frame 0 are 0"""


def fit_displacements(goal: Goal, twist: Array, settings: ChainSettings) -> Chains:
    """Fit the displacements of chains with fixed axes [S I 6] to a goal."""
    joints = twist.shape[1]

    def linearize(angle: Array, _: int) -> tuple[Array, Array]:
        motion, error = missing_twists(goal, Chains(twist, angle))
        row = displacement_twists(goal, twist, motion)
        weighted = goal.information @ row
        return (np.einsum("stgki,stgkj->stij", row, weighted, optimize=True),
                np.einsum("stgki,stgk->sti", weighted, error, optimize=True))

    def move(angle: Array, step: Array) -> Array:
        after = angle + step
        after[:, 0] = 0.0
        return after

    solver = Solver(settings.fit_held_damping, 1e-6, True, settings.fit_max_step)
    start = np.zeros((len(twist), len(goal.motion), joints))
    iterations = range(settings.fit_held_iterations)
    return Chains(twist, gauss_newton(start, linearize, move, iterations, solver))


def fit_chains(goal: Goal, start: Chains, settings: ChainSettings) -> Chains:
    """Fit displacements and axes of chains to a goal."""
    chains, frames, joints = start.angle.shape
    held, moves = (frames - 1) * joints, goal.moves

    def linearize(now: Chains, _: int) -> tuple[Array, Array]:
        motion, error = missing_twists(goal, now)
        adjoint, bases = se3.adjoint(motion), chain_axis_bases(goal, now.twist)
        row = np.zeros((*error.shape, held + sum(b.shape[2] for b in bases)))
        each, at = displacement_twists(goal, now.twist, motion), held
        for t in range(1, frames):
            row[:, t, ..., (t - 1) * joints : t * joints] = each[:, t]
        for j, b in enumerate(bases):
            turned = (adjoint[:, :, goal.parent[j] + 1] - adjoint[:, :, j + 1]) @ b[:, None]
            row[..., at : at + b.shape[2]] = turned[:, :, None] * moves[:, j, None, None]
            at += b.shape[2]
        square = np.einsum("stgi,tgij,stgj->stg", error, goal.information, error)
        median = np.median(square[:, 1:], axis=1, keepdims=True)
        trust = cauchy_weight(square / np.maximum(1e-12, settings.fit_robust_scale * median))
        weighted = (goal.information * trust[..., None, None]) @ row
        flat = weighted.reshape(chains, -1, row.shape[-1]).swapaxes(1, 2)
        return (flat @ row.reshape(chains, -1, row.shape[-1]),
                (flat @ error.reshape(chains, -1, 1))[..., 0])

    def move(now: Chains, step: Array) -> Chains:
        angle, twist, at = now.angle.copy(), now.twist.copy(), held
        angle[:, 1:] += step[:, :held].reshape(chains, frames - 1, joints)
        for j, b in enumerate(chain_axis_bases(goal, now.twist)):
            if b.shape[2]:
                by = (b @ step[:, at : at + b.shape[2], None])[..., 0]
                twist[:, j] = displace_axis(twist[:, j], by, bool(goal.prismatic[j]))
            at += b.shape[2]
        return replace(now, twist=twist, angle=angle)

    solver = Solver(settings.fit_damping, 1e-9, max_step=settings.fit_max_step)
    return gauss_newton(start, linearize, move, range(settings.fit_iterations), solver)


def chain_axis_bases(goal: Goal, twist: Array) -> list[Array]:
    """[S 6 d] for each joint: how the axes of chains [S I 6] may be displaced."""
    return [axis_basis(twist[:, j], bool(goal.prismatic[j]), goal.near[j], goal.axis_dof)
            for j in range(twist.shape[1])]


def displacement_twists(goal: Goal, twist: Array, motion: Array) -> Array:
    """[S T G 6 I] twists of the goal's parts per displacement, for chains [S I 6] and their
    motions."""
    each = se3.adjoint(motion[:, :, goal.parent + 1]) @ twist[:, None, :, :, None]
    return each[:, :, None, :, :, 0].swapaxes(-1, -2) * goal.moves[:, None, :]


def missing_twists(goal: Goal, chains: Chains) -> tuple[Array, Array]:
    """Return motions [S T I+1 4 4] of chains, and twists [S T G 6] from them to the goal's."""
    motion = part_motions(chains.twist, chains.angle, goal.parent)
    return motion, se3.log(goal.motion @ inverse(motion[:, :, goal.place + 1]))


def misfit(goal: Goal, chains: Chains) -> Array:
    """[S] mean distance of chains from the goal, in standard deviations."""
    _, error = missing_twists(goal, chains)
    square = np.einsum("stgi,tgij,stgj->stg", error, goal.information, error)
    return np.sqrt(np.maximum(square, 0.0)).mean(axis=(1, 2))
