"""Chains that make a given rigid motion (Sec. 3.3): jumps between solutions of one video.

What each part does is often found long before what the joints do: where inner parts are hidden or
axes are parallel, many chains lead through the same first frames. So the parts are let loose from
the chain, aligned freely over all frames, and many chains are fitted at once to what the surest of
them does, which takes no image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array, inverse
from .alignment import elements, surface_equations
from .articulation import ARM, Articulation, Cloud, Hypothesis, middles
from .chain import (
    adjoint,
    axis_basis,
    carriers,
    displace_axis,
    exponential,
    logarithm,
    part_motions,
)
from .crew import together
from .surface import Surfaces
from .sweep import directions, spread
from .tracker import Tracker, thinned

_LOOSENED = (8.0, 6.0, 4.0, 4.0, 2.0, 2.0, 1.0, 1.0)  # footprints, of an alignment each
_DAMPING = 1e-4
_STEP = 0.2  # largest change of an unknown in an iteration, rad or m
_HELD, _FREED = 8, 20  # iterations with axes held, then free
_STARTS, _PLACES = 600, 24
_FITTED = 180  # of the starts, whose axes are freed
_FITS, _WORSE = 1e-3, 2.0  # rad and m, of the motion, weighted; or times the best, with noise
_ALIKE = np.radians(2.0)  # of chains that are one, by displacements at the end
_KEPT = 0.3  # of the directions are as they are


@dataclass(frozen=True)
class PartMotion:
    """What a part does, whatever makes it do it."""

    path: NDArray[np.int64]
    """[I] joints that move it, from the base outward"""
    motion: Array
    """[T 4 4]"""
    information: Array
    """[T 6 6] of the twists on its left"""


def loosened(tracker: Tracker, guess: Hypothesis) -> PartMotion:
    """EM over all frames without the chain, from a hypothesis.

    Only the part that most is seen of is kept: the others are soon lost, or were never found.
    """
    motion, clouds = guess.state.motions(len(guess.state.angle)), guess.clouds
    information = np.zeros((*motion.shape[:2], 6, 6))
    for scale in _LOOSENED:
        motion, information = align_parts(tracker.surfaces, clouds, motion, scale)
        clouds = tuple(tracker.label_motion(motion, c.frame, scale)[0] for c in clouds)
    surest = 1 + int(np.argmax(np.trace(information[:, 1:].sum(axis=0), axis1=1, axis2=2)))
    path = np.flatnonzero(carriers(guess.state.parent)[surest])
    return PartMotion(path, motion[:, surest], balanced(information[:, surest]))


def balanced(information: Array) -> Array:
    """[T 6 6], with every frame counting alike where it is sure."""
    trace = np.trace(information, axis1=1, axis2=2)[:, None, None]
    return information / np.sqrt(np.maximum(trace, 1e-12) * max(1e-12, float(trace.max())))


def align_parts(
    surfaces: Surfaces, clouds: tuple[Cloud, ...], motion: Array, scale: float
) -> tuple[Array, Array]:
    """One iteration of Gauss-Newton on each part's motions [T J+1 4 4]; and their information."""
    frames, parts = motion.shape[:2]
    matrix = np.zeros((parts, frames, 6, frames, 6))
    vector = np.zeros((parts, frames, 6))
    every = np.arange(frames)
    for cloud in clouds:
        here_from_there = motion @ inverse(motion[cloud.frame])
        sigma = scale * (surfaces.footprint(cloud.point[:, 2]) + surfaces.noise)
        these = elements(cloud.point, cloud.normal, sigma, cloud.label, parts)
        six, right = (x.swapaxes(0, 1)
                      for x in surface_equations(surfaces, cloud.frame, here_from_there, these))
        there = -adjoint(here_from_there).swapaxes(0, 1)  # a twist of the frame it is from
        both, f = six @ there, cloud.frame
        matrix[:, every, :, every, :] += six.swapaxes(0, 1)
        vector += right
        if f:
            matrix[:, :, :, f] += both
            matrix[:, f] += both.transpose(0, 3, 1, 2)
            matrix[:, f, :, f] += np.einsum("ptiu,ptiv->puv", there, both)
            vector[:, f] += np.einsum("ptiu,pti->pu", there, right)
    information = matrix[:, every, :, every, :].copy()
    size = frames * 6
    flat = matrix.reshape(parts, size, size)
    diagonal = np.arange(size)
    flat[:, diagonal, diagonal] += _DAMPING * flat[:, diagonal, diagonal] + 1.0
    flat[:, :6, :6] += 1e15 * np.eye(6)  # frame 0 stays
    step = np.linalg.solve(flat, vector.reshape(parts, size, 1)).reshape(parts, frames, 6)
    step = np.clip(step, -_STEP, _STEP).swapaxes(0, 1)
    return exponential(step) @ motion, information


def factored(tracker: Tracker, guess: Hypothesis) -> list[Articulation]:
    """Chains that make what the surest part of a hypothesis does; the other joints stay."""
    goal, state = loosened(tracker, guess), guess.state
    starts = axes_at_random(tracker, state, np.random.default_rng(0))[:, goal.path]
    held = np.concatenate(together(lambda s: follow_held(goal, s), np.array_split(starts, 2)))
    best = np.argsort(misfit(goal, starts, held), kind="stable")[:_FITTED]
    near, freedom = middles(guess.clouds[0], len(state.twist))[goal.path], tracker.known.freedom
    prismatic = state.prismatic[goal.path]
    halves = together(
        lambda b: fit_chains(goal, starts[b], held[b], prismatic, near, freedom),
        (best[::2], best[1::2]),
    )
    twists, angles, cost = (np.concatenate(x) for x in zip(*halves, strict=True))
    enough = max(_FITS, _WORSE * float(cost.min()))
    arm = np.where(prismatic, ARM, 1.0)
    found: list[Articulation] = []
    for f in np.argsort(cost, kind="stable"):
        ends = [other.angle[-1, goal.path] for other in found]
        if cost[f] >= enough:
            break
        if all((np.abs(angles[f, -1] - e) / arm).max() > _ALIKE for e in ends):
            twist, angle = state.twist.copy(), state.angle.copy()
            twist[goal.path], angle[:, goal.path] = twists[f], angles[f]
            found.append(replace(state, twist=twist, angle=angle))
    return found


def axes_at_random(tracker: Tracker, state: Articulation, rng: np.random.Generator) -> Array:
    """[S J 6] hinges anywhere on what moves; directions as known, as in a sweep or as they are."""
    places = spread(thinned(tracker.grid(0).point[tracker.moving], 400), _PLACES)
    out = np.zeros((_STARTS, len(state.twist), 6))
    for s in range(_STARTS):
        before = None
        for j, prismatic in enumerate(state.prismatic):
            some = directions(tracker.known, j, before)
            before = some[rng.integers(len(some))]
            if tracker.known.direction is None and rng.random() < _KEPT:
                before = state.twist[j, 3:] if prismatic else state.twist[j, :3]
            place = places[rng.integers(len(places))]
            out[s, j, 3:] = before if prismatic else np.cross(place, before)
            out[s, j, :3] = 0.0 if prismatic else before
    return out


def follow_held(goal: PartMotion, twist: Array) -> Array:
    """Displacements [S T I] of chains [S I 6] whose axes are held, nearest to the motion."""
    joints = twist.shape[1]
    angle = np.zeros((len(twist), len(goal.motion), joints))
    for _ in range(_HELD):
        motion, error = errors(goal, twist, angle)
        row = by_displacement(twist, motion)
        weighted = goal.information @ row
        matrix = row.swapaxes(-1, -2) @ weighted
        size = np.trace(matrix, axis1=2, axis2=3)[..., None, None] / joints
        matrix += (1e-3 * size + 1e-6) * np.eye(joints)
        step = np.linalg.solve(matrix, weighted.swapaxes(-1, -2) @ error[..., None])[..., 0]
        angle += np.clip(step, -_STEP, _STEP)
        angle[:, 0] = 0.0
    return angle


def fit_chains(
    goal: PartMotion, twist: Array, angle: Array, prismatic: NDArray[np.bool_], near: Array,
    freedom: int,
) -> tuple[Array, Array, Array]:
    """Gauss-Newton on displacements [S T I] and axes [S I 6]; and the misfit [S].

    `near` [I 3] and freedom as in `axis_basis`.
    """
    chains, frames, joints = angle.shape
    held = (frames - 1) * joints
    for _ in range(_FREED):
        motion, error = errors(goal, twist, angle)
        ad = adjoint(motion)
        bases = [axis_basis(twist[:, j], bool(prismatic[j]), near[j], freedom)
                 for j in range(joints)]
        row = np.zeros((chains, frames, 6, held + sum(b.shape[2] for b in bases)))
        each, at = by_displacement(twist, motion), held
        for t in range(1, frames):
            row[:, t, :, (t - 1) * joints : t * joints] = each[:, t]
        for j, b in enumerate(bases):
            row[..., at : at + b.shape[2]] = (ad[:, :, j] - ad[:, :, j + 1]) @ b[:, None]
            at += b.shape[2]
        square = np.einsum("sti,tij,stj->st", error, goal.information, error)
        typical = np.maximum(1e-12, 4.0 * np.median(square[:, 1:], axis=1, keepdims=True))
        trust = 1.0 / (1.0 + square / typical)
        weighted = (goal.information * trust[..., None, None]) @ row
        flat = weighted.reshape(chains, frames * 6, -1).swapaxes(1, 2)
        matrix = flat @ row.reshape(chains, frames * 6, -1)
        diagonal = np.arange(matrix.shape[1])
        matrix[:, diagonal, diagonal] *= 1 + 1e-4
        matrix[:, diagonal, diagonal] += 1e-9
        step = np.linalg.solve(matrix, flat @ error.reshape(chains, -1, 1))[..., 0]
        step = np.clip(step, -_STEP, _STEP)
        angle = angle.copy()
        angle[:, 1:] += step[:, :held].reshape(chains, frames - 1, joints)
        twist, at = twist.copy(), held
        for j, b in enumerate(bases):
            if b.shape[2]:
                by = (b @ step[:, at : at + b.shape[2], None])[..., 0]
                twist[:, j] = displace_axis(twist[:, j], by, bool(prismatic[j]))
            at += b.shape[2]
    return twist, angle, misfit(goal, twist, angle)


def by_displacement(twist: Array, motion: Array) -> Array:
    """[S T 6 I] the last part's twist per displacement, for chains [S I 6] and their motion."""
    before = adjoint(motion[:, :, :-1])
    return (before @ twist[:, None, :, :, None])[..., 0].swapaxes(-1, -2)


def errors(goal: PartMotion, twist: Array, angle: Array) -> tuple[Array, Array]:
    """Motions [S T I+1 4 4] of chains, and the twists [S T 6] that the last part's lacks."""
    motion = part_motions(twist, angle, np.arange(-1, twist.shape[1] - 1))
    return motion, logarithm(goal.motion @ inverse(motion[:, :, -1]))


def misfit(goal: PartMotion, twist: Array, angle: Array) -> Array:
    """[S] how badly chains make the motion."""
    _, error = errors(goal, twist, angle)
    square = np.einsum("sti,tij,stj->st", error, goal.information, error)
    return np.sqrt(np.maximum(square, 0.0)).mean(axis=1)
