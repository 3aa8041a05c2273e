"""Chains that make given rigid motions (Sec. 3.3): jumps between solutions of one video.

What each part does is often found long before what the joints do: where inner parts are hidden or
axes are parallel, many chains lead through the same first frames. So the parts are let loose from
the chain, aligned freely over all frames, and many chains are fitted to their motions at once,
which takes no image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..robots.geometry import Array, inverse
from .alignment import elements, surface_equations
from .articulation import Articulation, Cloud, Hypothesis, axis_bases, derivatives, displaced
from .chain import adjoint, exponential, joint_motion, logarithm
from .crew import together
from .surface import Surfaces
from .sweep import directions, spread
from .tracker import Tracker, thinned

_LOOSENED = (8.0, 6.0, 4.0, 4.0, 2.0, 2.0, 1.0, 1.0)  # footprints, of an alignment each
_DAMPING = 1e-4
_STEP = 0.2  # largest change of an unknown in an iteration, rad or m
_HELD, _FREED = 8, 20  # iterations with axes held, then free
_STARTS, _PLACES = 1000, 24
_FITTED = 120  # of the starts, whose axes are freed
_FITS = 1e-3  # rad and m, of the surest part's motions, weighted
_KEPT = 0.3  # of the directions are as they are


@dataclass(frozen=True)
class Motions:
    """What the parts do, whatever makes them do it."""

    motion: Array
    """[T J+1 4 4]"""
    information: Array
    """[T J+1 6 6] of the twists on its left"""


def loosened(tracker: Tracker, guess: Hypothesis) -> Motions:
    """EM over all frames without the chain, from a hypothesis.

    Only of the part that most is seen of: the others are soon lost, or were never found.
    """
    motion, clouds = guess.state.motions(len(guess.state.angle)), guess.clouds
    information = np.zeros((*motion.shape[:2], 6, 6))
    for scale in _LOOSENED:
        motion, information = align_parts(tracker.surfaces, clouds, motion, scale)
        clouds = tuple(tracker.label_motion(motion, c.frame, scale)[0] for c in clouds)
    surest = int(np.argmax(np.trace(information.sum(axis=0), axis1=1, axis2=2)))
    information[:, np.arange(motion.shape[1]) != surest] = 0.0
    return Motions(motion, information)


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
    """Chains that make what the surest part of a hypothesis does."""
    goal = loosened(tracker, guess)
    starts = axes_at_random(tracker, guess.state, np.random.default_rng(0))
    held = follow_held(goal, starts)
    best = np.argsort(misfit(goal, starts, held), kind="stable")[:_FITTED]
    found = together(lambda s: fit_chain(
        goal, replace(guess.state, twist=starts[s], angle=held[s]), guess.clouds,
        tracker.known.freedom), best)
    return [state for state, cost in found if cost < _FITS]


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


def follow_held(goal: Motions, twist: Array) -> Array:
    """Displacements [S T J] of chains [S J 6] whose axes are held, nearest to those motions."""
    frames, joints = len(goal.motion), twist.shape[1]
    angle = np.zeros((len(twist), frames, joints))
    weight = balanced(goal)
    for _ in range(_HELD):
        motion, error = errors(goal, twist, angle)
        row = np.zeros((*motion.shape[:3], 6, joints))  # [S T J+1 6 J]
        for j in range(joints):
            row[:, :, j + 1 :, :, j] = (adjoint(motion[:, :, j]) @ twist[:, None, j, :, None]
                                        )[:, :, None, :, 0]
        weighted = np.einsum("stpij,tpik->stpkj", row, weight)
        matrix = np.einsum("stpkj,stpkl->stjl", weighted, row)
        vector = np.einsum("stpkj,stpk->stj", weighted, error)
        size = np.trace(matrix, axis1=2, axis2=3)[..., None, None] / joints
        matrix += (1e-3 * size + 1e-6) * np.eye(joints)
        step = np.linalg.solve(matrix, vector[..., None])[..., 0]
        angle += np.clip(step, -_STEP, _STEP)
        angle[:, 0] = 0.0
    return angle


def errors(goal: Motions, twist: Array, angle: Array) -> tuple[Array, Array]:
    """Motions [S T J+1 4 4] of chains, and the twists [S T J+1 6] that they lack."""
    each = joint_motion(twist[:, None], angle)
    motion = np.tile(np.eye(4), (*angle.shape[:2], twist.shape[1] + 1, 1, 1))
    for j in range(twist.shape[1]):
        motion[:, :, j + 1] = motion[:, :, j] @ each[:, :, j]
    return motion, logarithm(goal.motion @ inverse(motion))


def balanced(goal: Motions) -> Array:
    """The information, with every part and frame counting alike where it is sure."""
    trace = np.trace(goal.information, axis1=2, axis2=3)[..., None, None]
    return goal.information / np.sqrt(np.maximum(trace, 1e-12) * max(1e-12, float(trace.max())))


def misfit(goal: Motions, twist: Array, angle: Array) -> Array:
    """[S] how badly chains make the motions."""
    _, error = errors(goal, twist, angle)
    square = np.einsum("stpi,tpij,stpj->stp", error, balanced(goal), error)
    return np.sqrt(np.maximum(square, 0.0)).mean(axis=(1, 2))


def fit_chain(
    goal: Motions, state: Articulation, clouds: tuple[Cloud, ...], freedom: int
) -> tuple[Articulation, float]:
    """Gauss-Newton on displacements and axes; and the misfit."""
    last, joints = len(state.angle) - 1, len(state.twist)
    held, weight = last * joints, balanced(goal)
    for _ in range(_FREED):
        basis = axis_bases(state, clouds, freedom)
        motion = state.motions(last + 1)
        error = logarithm(goal.motion @ inverse(motion))
        row = derivatives(state, motion, basis)
        square = np.einsum("tpi,tpij,tpj->tp", error, weight, error)
        trust = 1.0 / (1.0 + square / max(1e-12, 4.0 * float(np.median(square[1:, 1:]))))
        weighted = (weight * trust[..., None, None]) @ row
        size = row.shape[-1]
        matrix = row.reshape(-1, size).T @ weighted.reshape(-1, size)
        vector = np.einsum("tpiu,tpi->u", weighted, error)
        matrix += np.diag(1e-4 * np.diag(matrix) + 1e-9)
        step = np.clip(np.linalg.solve(matrix, vector), -_STEP, _STEP)
        angle = state.angle.copy()
        angle[1:] += step[:held].reshape(last, joints)
        state = replace(state, angle=angle, twist=displaced(state, basis, step[held:]))
        if np.abs(step).max() < 1e-5:
            break
    return state, float(misfit(goal, state.twist[None], state.angle[None])[0])
