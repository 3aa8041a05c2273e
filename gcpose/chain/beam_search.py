"""Starts by beam search along a chain: every joint's first step in a grid of values.

A joint's hinge is at one of some places on what moves, its step one of some values; a point costs
what the best part so far costs it. A hinge that is wrong by some centimetres hardly matters for so
small a turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from ...robots.geometry import Array
from ..numerics import Image
from .kinematics import part_motions
from .priors import Known
from .settings import ChainSettings

_ALONE = np.array([-1])  # what carries a joint, where no other is looked at


class Judge(Protocol):
    """What the images say of N points' motions."""

    def costs(self, motion: Array) -> Image:
        """[M N] of the points, moved by each of motion [M 4 4]"""
        ...

    def means(self, motion: Array, turn: Array, before: Image) -> Image:
        """[M P] mean cost of M chains that cost `before` [M N], with one more part that moves as
        each of motion [M 4 4] and of turn [P 4 4] behind it"""
        ...


@dataclass(frozen=True)
class Grid:
    """The first steps of a chain that are searched."""

    roots: Array
    """[R 3] places of the axes of joints on the base, where they are not known"""
    places: Array
    """[P 3] places of the other axes"""
    turn: float
    """Largest turn, rad."""
    slide: float
    """Largest slide."""
    width: int
    """Chains that are extended by the next joint."""


class Beam(NamedTuple):
    """M chains of j joints."""

    motion: Array
    """[M j+1 4 4] of the parts"""
    cost: Image
    """[M N] of each point under the best part so far"""
    twist: Array
    """[M j 6]"""
    angle: Array
    """[M j]"""


def beamed(known: Known, judge: Judge, grid: Grid, settings: ChainSettings) -> Beam:
    """The best chains of a grid of steps, the best first."""
    still = np.eye(4)[None]
    beam = Beam(still[None], judge.costs(still), np.zeros((1, 0, 6)), np.zeros((1, 0)))
    for j, prismatic in enumerate(known.prismatic):
        grown: list[Beam] = []
        step = np.linspace(-1, 1, settings.beam_values) * (grid.slide if prismatic else grid.turn)
        for before, group in families(beam, known):
            near = grid.places if known.parent[j] >= 0 else grid.roots
            lines = axes(known, j, directions(known, j, before, settings), near)
            if len(lines) == 1:
                step = np.linspace(step[0], step[-1], 2 * settings.beam_values - 1)
            twist, by = lines.repeat(len(step), axis=0), np.tile(step, len(lines))
            turns = part_motions(twist[:, None], by[:, None, None], _ALONE)[:, 0, 1]
            carrier = group.motion[:, known.parent[j] + 1]
            mean = judge.means(carrier, turns, group.cost).reshape(-1)
            best = np.argsort(mean, kind="stable")[: grid.width]
            old, new = np.divmod(best, len(turns))
            line, value = np.divmod(new, len(step))
            motion = carrier[old] @ turns[new]
            grown.append(Beam(
                np.concatenate([group.motion[old], motion[:, None]], axis=1),
                np.minimum(group.cost[old], judge.costs(motion)),
                np.concatenate([group.twist[old], lines[line][:, None]], axis=1),
                np.concatenate([group.angle[old], step[value][:, None]], axis=1),
            ))
        beam = Beam(
            np.concatenate([b.motion for b in grown]), np.concatenate([b.cost for b in grown]),
            np.concatenate([b.twist for b in grown]), np.concatenate([b.angle for b in grown]),
        )
        go_on = grid.width
        if known.direction is None:
            go_on //= settings.beam_divisor
        beam = chosen(beam, np.argsort(beam.cost.mean(axis=1), kind="stable")[:go_on])
    return beam


def chosen(beam: Beam, which: NDArray[np.intp]) -> Beam:
    """Some of the chains."""
    return Beam(beam.motion[which], beam.cost[which], beam.twist[which], beam.angle[which])


def unlike(beam: Beam, most: int) -> Beam:
    """The best chains of which no two make the same steps."""
    _, first = np.unique(beam.angle.round(6), axis=0, return_index=True)
    return chosen(beam, np.sort(first)[:most])


def families(beam: Beam, known: Known) -> list[tuple[Array | None, Beam]]:
    """The chains by the direction [3] of their last axis, where the next one's depends on it."""
    if known.direction is not None or beam.twist.shape[1] == 0:
        return [(None, beam)]
    turns = np.any(beam.twist[:, -1, :3], axis=1, keepdims=True)
    last = np.where(turns, beam.twist[:, -1, :3], beam.twist[:, -1, 3:])
    kinds, which = np.unique(last.round(6), axis=0, return_inverse=True)
    members = [np.flatnonzero(which.reshape(-1) == i) for i in range(len(kinds))]
    return [(k / np.linalg.norm(k), chosen(beam, m))
            for k, m in zip(kinds, members, strict=True)]


def directions(
    known: Known, joint: int, before: Array | None, settings: ChainSettings
) -> Array:
    """[D 3] where an axis may point: as known; or upright, then parallel to the one before it or
    across, as machines are built and images are taken."""
    if known.direction is not None:
        return known.direction[joint][None]
    if before is None:
        tilt = np.array(settings.beam_tilts)
        return np.stack([0 * tilt, -np.cos(tilt), -np.sin(tilt)], axis=1)
    across = np.linalg.svd(before[None])[2][1:]
    turn = np.arange(settings.beam_directions) * np.pi / settings.beam_directions
    round_about = np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]
    return np.concatenate([before[None], round_about])


def axes(known: Known, joint: int, direction: Array, places: Array) -> Array:
    """Twists [P 6] of a joint with any of the directions [D 3], at any of the places."""
    if known.line is not None:
        return known.line[joint][None]
    if known.prismatic[joint]:
        return np.concatenate([np.zeros_like(direction), direction], axis=1)
    l, p = direction.repeat(len(places), axis=0), np.tile(places, (len(direction), 1))
    return np.concatenate([l, np.asarray(np.cross(p, l), np.float64)], axis=1)


def spread(points: Array, most: int) -> Array:
    """Places [P 3] all over the points [N 3], each the middle of those that are near."""
    apart = cdist(points, points)
    chosen = [0]
    while len(chosen) < min(most, len(points)):
        chosen.append(int(apart[chosen].min(axis=0).argmax()))
    near = apart[chosen].argmin(axis=0)
    return np.stack([points[near == c].mean(axis=0) for c in range(len(chosen))])
