"""Chains that make a given rigid motion (Sec. 3.3): jumps between solutions of one video.

What each part does is often found long before what the joints do: where inner parts are hidden or
axes are parallel, many chains lead through the same first frames. So the parts are let loose from
the chain, aligned freely over all frames, and many chains are fitted to what the surest of them
does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...robots.geometry import Array, inverse, se3
from ..chain import (
    Articulation,
    Chains,
    Cloud,
    Goal,
    Hypothesis,
    carriers,
    directions,
    fit_chains,
    fit_displacements,
    middles,
    misfit,
    spread,
    thinned,
)
from ..images import Surfaces
from ..numerics import Solver, together
from .alignment import elements, surface_equations
from .settings import RgbdSettings
from .tracker import Tracker


def goals(tracker: Tracker, guess: Hypothesis) -> list[Goal]:
    """What the surest part of a hypothesis does, in its place; and in the place of a neighbour,
    which is then in its own: a hypothesis may have taken the one for the other.

    The other parts are soon lost when they are loose, or were never found.
    """
    parent, near = guess.state.parent, middles(guess.clouds[0], len(guess.state.parent))
    motion, information = loosened(tracker, guess)
    surest = int(np.argmax(np.trace(information[:, 1:].sum(axis=0), axis1=1, axis2=2)))
    swaps = [[j, int(p)] for j, p in enumerate(parent) if p >= 0 and surest in (j, p)]
    out: list[Goal] = []
    for joints, places in [([surest], [surest]), *((both, both[::-1]) for both in swaps)]:
        path = np.flatnonzero(carriers(parent)[np.array(places) + 1].any(axis=0))
        carried = np.where(parent[path] < 0, -1, np.searchsorted(path, parent[path]))
        sure = [balanced(information[:, j + 1]) for j in joints]
        out.append(Goal(path, carried, np.searchsorted(path, places),
                        motion[:, np.array(joints) + 1], np.stack(sure, axis=1),
                        guess.state.prismatic[path], near[path], tracker.known.freedom))
    return out


def loosened(tracker: Tracker, guess: Hypothesis) -> tuple[Array, Array]:
    """EM over all frames without the chain, from a hypothesis: the parts' motions [T J+1 4 4], and
    the information [T J+1 6 6] of the twists on their left."""
    motion, clouds = guess.state.motions(len(guess.state.angle)), guess.clouds
    information = np.zeros((*motion.shape[:2], 6, 6))
    for scale in tracker.settings.motion.scales:
        motion, information = align_parts(tracker.surfaces, clouds, motion, scale,
                                          tracker.settings)
        clouds = tuple(tracker.label_motion(motion, c.frame, scale)[0] for c in clouds)
    return motion, information


def balanced(information: Array) -> Array:
    """[T 6 6], with every frame counting alike where it is sure."""
    trace = np.trace(information, axis1=1, axis2=2)[:, None, None]
    return information / np.sqrt(np.maximum(trace, 1e-12) * max(1e-12, float(trace.max())))


def align_parts(
    surfaces: Surfaces, clouds: tuple[Cloud, ...], motion: Array, scale: float,
    settings: RgbdSettings,
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
                      for x in surface_equations(surfaces, cloud.frame, here_from_there, these,
                                             settings.bundle))
        there = -se3.adjoint(here_from_there).swapaxes(0, 1)  # a twist of the frame it is from
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
    tuned = settings.motion
    solver = Solver(tuned.damping, tuned.damping_floor, max_step=tuned.max_step)
    step = solver.step(matrix.reshape(parts, size, size), vector.reshape(parts, size),
                       frozen=np.arange(size) < 6)  # frame 0
    return se3.exp(step.reshape(parts, frames, 6).swapaxes(0, 1)) @ motion, information


def factored(tracker: Tracker, guess: Hypothesis) -> list[Articulation]:
    """Chains that make what the surest parts of a hypothesis do; the other joints stay."""
    starts = axes_at_random(tracker, guess.state, np.random.default_rng(0))
    return [state for goal in goals(tracker, guess)
            for state in reaching(tracker, guess, goal, starts[:, goal.path])]


def reaching(
    tracker: Tracker, guess: Hypothesis, goal: Goal, starts: Array
) -> list[Articulation]:
    """The chains that reach a goal, the nearest first, from axes [S I 6]."""
    state, tuned, chain = guess.state, tracker.settings.motion, tracker.settings.chain
    held = together(lambda s: fit_displacements(goal, s, chain), np.array_split(starts, 2))
    angles = np.concatenate([h.angle for h in held])
    best = np.argsort(misfit(goal, Chains(starts, angles)), kind="stable")[: tuned.fitted]
    halves = together(lambda b: fit_chains(goal, Chains(starts[b], angles[b]), chain),
                      (best[::2], best[1::2]))
    twists = np.concatenate([h.twist for h in halves])
    angles = np.concatenate([h.angle for h in halves])
    cost = misfit(goal, Chains(twists, angles))
    enough = max(tuned.max_misfit, tuned.misfit_factor * float(cost.min()))
    arm = np.where(goal.prismatic, chain.slide_arm, 1.0)
    found: list[Articulation] = []
    for f in np.argsort(cost, kind="stable"):
        ends = [other.angle[-1, goal.path] for other in found]
        if cost[f] >= enough:
            break
        if all((np.abs(angles[f, -1] - e) / arm).max() > tuned.min_difference for e in ends):
            twist, angle = state.twist.copy(), state.angle.copy()
            twist[goal.path], angle[:, goal.path] = twists[f], angles[f]
            found.append(replace(state, twist=twist, angle=angle))
    return found


def axes_at_random(tracker: Tracker, state: Articulation, rng: np.random.Generator) -> Array:
    """[S J 6] hinges anywhere on what moves; directions as known, as in a sweep or as they are."""
    tuned = tracker.settings.motion
    moving = tracker.grid(0).point[tracker.moving]
    places = spread(thinned(moving, tuned.spread_points), tuned.places)
    out = np.zeros((tuned.starts, len(state.twist), 6))
    for s in range(tuned.starts):
        before = None
        for j, prismatic in enumerate(state.prismatic):
            some = directions(tracker.known, j, before, tracker.settings.chain)
            before = some[rng.integers(len(some))]
            if tracker.known.direction is None and rng.random() < tuned.kept_directions:
                before = state.twist[j, 3:] if prismatic else state.twist[j, :3]
            place = places[rng.integers(len(places))]
            out[s, j, 3:] = before if prismatic else np.cross(place, before)
            out[s, j, :3] = 0.0 if prismatic else before
    return out
