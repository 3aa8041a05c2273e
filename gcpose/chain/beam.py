"""Starts by beam search along a chain (Lowerre, The Harpy speech recognition system, 1976).

The first step of every joint is one of a few values, and its hinge at one of a few places on what
moves. The cost of a point is that of the best part so far. An error of some centimeters in a hinge
hardly matters for a small turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from ...robots.geometry import Array
from ..numerics import Image
from .articulation import Articulation
from .kinematics import part_motions
from .priors import JointPriors
from .settings import ChainSettings

_ALONE = np.array([-1])  # the parent of a joint that is moved alone


@dataclass(frozen=True)
class StepCosts:
    """Costs of N points in a frame, by compiled loops that fill in their last argument."""

    points: int
    """N"""
    fill_costs: Callable[[Array, Image], None]
    """Costs [M N] of the points under each of motion [M 4 4]."""
    fill_means: Callable[[Array, Array, Image, Image], None]
    """Mean costs [M P] of M chains with one more part, which moves by any of motion [M 4 4] times
    any of turn [P 4 4], and with costs before [M N]."""

    def costs(self, motion: Array) -> Image:
        """Return costs [M N] of the points under each of motion [M 4 4]."""
        out = np.empty((len(motion), self.points), np.float32)
        self.fill_costs(motion, out)
        return out

    def means(self, motion: Array, turn: Array, before: Image) -> Image:
        """Return mean costs [M P] of chains with one more part (see `fill_means`)."""
        out = np.empty((len(motion), len(turn)), np.float32)
        self.fill_means(motion, turn, before, out)
        return out


@dataclass(frozen=True)
class StepGrid:
    """First steps of a chain."""

    roots: Array
    """[R 3] places of the axes of joints on the base, if not known, m"""
    places: Array
    """[P 3] places of the other axes, m"""
    turn: float
    """Largest turn, rad"""
    slide: float
    """Largest slide, m"""
    width: int
    """Chains that are extended by the next joint"""


class Beam(NamedTuple):
    """M chains of j joints."""

    motion: Array
    """[M j+1 4 4] of the parts"""
    cost: Image
    """[M N] of each point under its best part"""
    twist: Array
    """[M j 6]"""
    angle: Array
    """[M j] rad or m"""

    def articulations(self, priors: JointPriors, to: int, most: int) -> list[Articulation]:
        """Return the best `most` chains, which make their steps evenly from frame 0 to `to`."""
        return [Articulation(twist, np.linspace(0 * end, end, to + 1), priors.prismatic,
                             priors.parent)
                for twist, end in zip(self.twist[:most], self.angle[:most], strict=True)]


def beam_search(
    priors: JointPriors, costs: StepCosts, grid: StepGrid, settings: ChainSettings
) -> Beam:
    """Search the first steps of a chain, joint by joint; the best chains come first."""
    at_rest = np.eye(4)[None]
    beam = Beam(at_rest[None], costs.costs(at_rest), np.zeros((1, 0, 6)), np.zeros((1, 0)))
    for j, prismatic in enumerate(priors.prismatic):
        extended: list[Beam] = []
        step = np.linspace(-1, 1, settings.beam_values) * (grid.slide if prismatic else grid.turn)
        for before, group in group_by_direction(beam, priors):
            near = grid.places if priors.parent[j] >= 0 else grid.roots
            lines = axis_twists(priors, j, axis_directions(priors, j, before, settings), near)
            if len(lines) == 1:
                step = np.linspace(step[0], step[-1], 2 * settings.beam_values - 1)
            extended.append(extend(group, priors.parent[j], lines, step, costs, grid.width))
        beam = merge_beams(extended)
        kept = grid.width
        if priors.direction is None:
            kept //= settings.beam_divisor
        beam = select_chains(beam, np.arange(min(kept, len(beam.cost))))
    return beam


def extend(
    beam: Beam, parent: int, lines: Array, step: Array, costs: StepCosts, width: int
) -> Beam:
    """Return the best `width` chains with one more joint on part `parent` + 1, which has any of the
    axes lines [L 6] and makes any of the steps [S]."""
    twist, by = lines.repeat(len(step), axis=0), np.tile(step, len(lines))
    turns = part_motions(twist[:, None], by[:, None, None], _ALONE)[:, 0, 1]
    carrier = beam.motion[:, parent + 1]
    mean = costs.means(carrier, turns, beam.cost).reshape(-1)
    old, new = np.divmod(np.argsort(mean, kind="stable")[:width], len(turns))
    line, value = np.divmod(new, len(step))
    motion = carrier[old] @ turns[new]
    return Beam(
        np.concatenate([beam.motion[old], motion[:, None]], axis=1),
        np.minimum(beam.cost[old], costs.costs(motion)),
        np.concatenate([beam.twist[old], lines[line][:, None]], axis=1),
        np.concatenate([beam.angle[old], step[value][:, None]], axis=1),
    )


def merge_beams(beams: Sequence[Beam]) -> Beam:
    """Return the chains of all beams, the best first."""
    merged = Beam(*(np.concatenate(parts) for parts in zip(*beams, strict=True)))
    return select_chains(merged, np.argsort(merged.cost.mean(axis=1), kind="stable"))


def select_chains(beam: Beam, which: NDArray[np.intp]) -> Beam:
    """Return some of the chains."""
    return Beam(beam.motion[which], beam.cost[which], beam.twist[which], beam.angle[which])


def select_by_steps(beam: Beam, most: int) -> Beam:
    """Return the best chains, no two of which make the same steps."""
    _, first = np.unique(beam.angle.round(6), axis=0, return_index=True)
    return select_chains(beam, np.sort(first)[:most])


def group_by_direction(beam: Beam, priors: JointPriors) -> list[tuple[Array | None, Beam]]:
    """Group chains by the direction [3] of their last axis, where the next one depends on it."""
    if priors.direction is not None or beam.twist.shape[1] == 0:
        return [(None, beam)]
    turns = np.any(beam.twist[:, -1, :3], axis=1, keepdims=True)
    last = np.where(turns, beam.twist[:, -1, :3], beam.twist[:, -1, 3:])
    kinds, which = np.unique(last.round(6), axis=0, return_inverse=True)
    members = [np.flatnonzero(which.reshape(-1) == i) for i in range(len(kinds))]
    return [(k / np.linalg.norm(k), select_chains(beam, m))
            for k, m in zip(kinds, members, strict=True)]


def axis_directions(
    priors: JointPriors, joint: int, before: Array | None, settings: ChainSettings
) -> Array:
    """Return the directions [D 3] that an axis may have.

    If none is known, the first axis is upright, and each other one parallel or perpendicular to the
    one before, as most machines are built and most images are taken.
    """
    if priors.direction is not None:
        return priors.direction[joint][None]
    if before is None:
        tilt = np.array(settings.beam_tilts)
        return np.stack([0 * tilt, -np.cos(tilt), -np.sin(tilt)], axis=1)
    across = np.linalg.svd(before[None])[2][1:]
    turn = np.arange(settings.beam_directions) * np.pi / settings.beam_directions
    perpendicular = np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]
    return np.concatenate([before[None], perpendicular])


def axis_twists(priors: JointPriors, joint: int, direction: Array, places: Array) -> Array:
    """Return axes [D*P 6] of a joint with any of the directions [D 3] at any of the places [P 3];
    one axis if its line is known."""
    if priors.line is not None:
        return priors.line[joint][None]
    if priors.prismatic[joint]:
        return np.concatenate([np.zeros_like(direction), direction], axis=1)
    l, p = direction.repeat(len(places), axis=0), np.tile(places, (len(direction), 1))
    return np.concatenate([l, np.asarray(np.cross(p, l), np.float64)], axis=1)


def spread_places(points: Array, most: int, compared: int) -> Array:
    """Return at most `most` places [P 3] spread over the points [N 3]: means of the points nearest
    to each of some that are chosen by farthest-point sampling (Eldar et al., 1997). About
    `compared` points are used, evenly by index."""
    points = points[np.linspace(0, len(points) - 1, min(len(points), compared)).astype(int)]
    apart = cdist(points, points)
    sampled = [0]
    while len(sampled) < min(most, len(points)):
        sampled.append(int(apart[sampled].min(axis=0).argmax()))
    near = apart[sampled].argmin(axis=0)
    return np.stack([points[near == c].mean(axis=0) for c in range(len(sampled))])
