"""Other chains with the same part motion (Sec. 3.3): changes between solutions of one video.

The motions of the parts are often found before those of the joints: where inner parts are hidden
or axes are parallel, many chains explain the first frames. So the parts are aligned over all frames
without the chain, and many chains are fitted to the motion of the surest part.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...robots.geometry import Array, inverse, se3
from ..chain import (
    Articulation,
    Chains,
    Goal,
    ancestors,
    axis_directions,
    fit_chains,
    fit_displacements,
    misfit,
    spread_places,
)
from ..images import Surfaces
from ..numerics import Solver, thread_map
from .evidence import DepthHypothesis, RgbdEvidence
from .labels import Clouds, part_centers
from .residuals import sort_surfels, surface_equations
from .settings import RgbdSettings


def make_goals(evidence: RgbdEvidence, hypothesis: DepthHypothesis) -> list[Goal]:
    """Return goals with the motion of the surest part, and with that of its neighbors swapped.

    A hypothesis may have taken a part for its neighbor. The motions of other parts are unreliable
    without the chain.
    """
    parent = hypothesis.state.parent
    near = part_centers(hypothesis.points[0], len(parent))
    motion, information = align_freely(evidence, hypothesis)
    surest = int(np.argmax(np.trace(information[:, 1:].sum(axis=0), axis1=1, axis2=2)))
    swaps = [[j, int(p)] for j, p in enumerate(parent) if p >= 0 and surest in (j, p)]
    out: list[Goal] = []
    for joints, places in [([surest], [surest]), *((both, both[::-1]) for both in swaps)]:
        path = np.flatnonzero(ancestors(parent)[np.array(places) + 1].any(axis=0))
        inner = np.where(parent[path] < 0, -1, np.searchsorted(path, parent[path]))
        sure = information[:, np.array(joints) + 1]
        trace = np.trace(sure, axis1=2, axis2=3)[..., None, None]  # of all frames, made alike
        sure = sure / np.sqrt(np.maximum(trace, 1e-12) * np.maximum(trace.max(axis=0), 1e-12))
        out.append(Goal(path, inner, np.searchsorted(path, places),
                        motion[:, np.array(joints) + 1], sure,
                        hypothesis.state.prismatic[path], near[path], evidence.priors.axis_dof))
    return out


def align_freely(evidence: RgbdEvidence, hypothesis: DepthHypothesis) -> tuple[Array, Array]:
    """Align the parts of a hypothesis over all frames without the chain, by EM.

    Returns motions [T J+1 4 4] and the information [T J+1 6 6] of the twists on their left.
    """
    motion, clouds = hypothesis.state.motions(len(hypothesis.state.angle)), hypothesis.points
    surfaces, settings = evidence.surfaces, evidence.settings
    information = np.zeros((*motion.shape[:2], 6, 6))
    for scale in settings.motion.scales:
        motion, information = align_parts(surfaces, clouds, motion, scale, settings)
        clouds = Clouds(evidence.label_frame(motion, c.frame, scale)[0] for c in clouds)
    return motion, information


def align_parts(
    surfaces: Surfaces, clouds: Clouds, motion: Array, scale: float,
    settings: RgbdSettings,
) -> tuple[Array, Array]:
    """Improve each part's motions [T J+1 4 4] by one Gauss-Newton step; return them and their
    information [T J+1 6 6]. `scale` is in footprints."""
    frames, parts = motion.shape[:2]
    matrix = np.zeros((parts, frames, 6, frames, 6))
    vector = np.zeros((parts, frames, 6))
    every = np.arange(frames)
    for cloud in clouds:
        here_from_there = motion @ inverse(motion[cloud.frame])
        sigma = scale * (surfaces.footprint(cloud.point[:, 2]) + surfaces.noise)
        surfels = sort_surfels(cloud.point, cloud.normal, sigma, cloud.label, parts)
        equations = surface_equations(surfaces, cloud.frame, here_from_there, surfels,
                                      settings.bundle)
        six, right = (x.swapaxes(0, 1) for x in equations)
        there = -se3.adjoint(here_from_there).swapaxes(0, 1)  # by twists of the cloud's frame
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
    solver = Solver(tuned.damping, settings.bundle.damping_floor, max_step=tuned.max_step)
    step = solver.step(matrix.reshape(parts, size, size), vector.reshape(parts, size),
                       frozen=np.arange(size) < 6)  # of frame 0
    return se3.exp(step.reshape(parts, frames, 6).swapaxes(0, 1)) @ motion, information


def chains_from_motion(evidence: RgbdEvidence, hypothesis: DepthHypothesis) -> list[Articulation]:
    """Return chains that give the surest parts of a hypothesis the same motion; joints that do not
    move these parts are not changed."""
    starts = random_axes(evidence, hypothesis.state, np.random.default_rng(0))
    return [state for goal in make_goals(evidence, hypothesis)
            for state in reach_goal(evidence, hypothesis, goal, starts[:, goal.path])]


def reach_goal(
    evidence: RgbdEvidence, hypothesis: DepthHypothesis, goal: Goal, starts: Array
) -> list[Articulation]:
    """Return the chains that reach a goal from axes [S I 6], the nearest first."""
    state, tuned, chain = hypothesis.state, evidence.settings.motion, evidence.settings.chain
    held = thread_map(lambda s: fit_displacements(goal, s, chain), np.array_split(starts, 2))
    angles = np.concatenate([h.angle for h in held])
    best = np.argsort(misfit(goal, Chains(starts, angles)), kind="stable")[: tuned.fitted]
    halves = thread_map(lambda b: fit_chains(goal, Chains(starts[b], angles[b]), chain),
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


def random_axes(evidence: RgbdEvidence, state: Articulation, rng: np.random.Generator) -> Array:
    """Return random axes [S J 6] with hinges on what moves.

    Directions are as known, or random among those of a sweep and those of the hypothesis.
    """
    tuned = evidence.settings.motion
    moving = evidence.grid(0).point[evidence.moving]
    places = spread_places(moving, tuned.places, evidence.settings.sweep.spread_points)
    out = np.zeros((tuned.starts, len(state.twist), 6))
    for s in range(tuned.starts):
        before = None
        for j, prismatic in enumerate(state.prismatic):
            some = axis_directions(evidence.priors, j, before, evidence.settings.chain)
            before = some[rng.integers(len(some))]
            if evidence.priors.direction is None and rng.random() < tuned.kept_directions:
                before = state.twist[j, 3:] if prismatic else state.twist[j, :3]
            place = places[rng.integers(len(places))]
            out[s, j, 3:] = before if prismatic else np.cross(place, before)
            out[s, j, :3] = 0.0 if prismatic else before
    return out
