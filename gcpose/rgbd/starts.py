"""Where the search begins: parts cut in many ways, their motion from flow and depth (Sec. 3.3)."""

from __future__ import annotations

from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import (
    Articulation,
    Cloud,
    Hypothesis,
    Known,
    about,
    axis_from,
    carriers,
    distinct,
    extent,
    hinges,
    spaces,
)
from ..images import Flow, smooth
from ..numerics import together
from .flow_motion import Correspondence, correspond, costs, fit
from .labels import Candidates
from .tracker import Tracker

_CUTS = (0.06, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9)  # of the way from the base outward
_SLIPS = (0.0075, 0.0015)  # how far a hinge may move in a start, of the object's size


def beginnings(tracker: Tracker, flow: Flow, spans: tuple[int, ...], most: int) -> list[Hypothesis]:
    """The best starts by flow from frame 0 over each of `spans` frames."""
    grid, known, rank = tracker.grid(0), tracker.known, tracker.ranks[0]
    origin = grid.point[tracker.moving].mean(axis=0)
    first = starts(rank, tracker.moving, len(known.prismatic))
    found: list[Hypothesis] = []
    for span in spans:
        to = min(span, tracker.surfaces.frames - 1)
        field = flow(tracker.rgb[0], tracker.rgb[to])
        field = field[grid.pixel[:, 1], grid.pixel[:, 0]].astype(np.float64)
        data = correspond(tracker.surfaces, grid.point, grid.pixel, field, to, origin)
        for slip in _SLIPS if known.freedom else _SLIPS[:1]:
            moved = partial(first_motion, data, grid, tracker.bases[0], known, origin, to, slip)
            found += distinct(together(moved, first), most)
    return found


def starts(rank: Array, moving: NDArray[np.bool_], joints: int) -> list[NDArray[np.int64]]:
    """Initial labels: moving points cut into J runs from the base outward, in many ways."""
    return [
        np.where(moving, 1 + np.searchsorted(np.array(cuts), rank), 0)
        for cuts in combinations(_CUTS, joints - 1)
    ]


def first_motion(
    data: Correspondence,
    grid: Candidates,
    base: Array,
    known: Known,
    origin: Array,
    to: int,
    slip: float,
    label: NDArray[np.int64],
) -> Hypothesis:
    """EM over frames 0 and `to` from initial labels [N]; the displacement goes on evenly."""
    joints = len(known.prismatic)
    space = tuple(about(origin, s.T).T for s in spaces(known))
    added = [np.zeros(6)] * joints
    moves = carriers(known.parent)
    scale = extent(grid.point[label > 0]) if (label > 0).any() else 1.0
    cost = np.inf
    at = hinges(grid.point, label, base, known.parent)
    for _ in range(5):
        at = hinges(grid.point, label, base, known.parent)
        prior = np.stack([hinge_prior(p - origin, slip * scale) for p in at])
        added = fit(data, label, space, prior, moves)
        volume = smooth(costs(data, added, moves), grid)
        label = volume.argmin(axis=1)
        cost = float(volume.min(axis=1).mean())
    twist, angle = np.zeros((joints, 6)), np.zeros((to + 1, joints))
    for j in range(joints):
        z = about(-origin, added[j])
        twist[j], end = axis_from(z, known, j, at[j], np.radians(0.3))
        angle[:, j] = np.linspace(0, end, to + 1)
    cloud = Cloud(0, grid.point, grid.normal, label)
    return Hypothesis(Articulation(twist, angle, known.prismatic, known.parent), (cloud,), cost)


def hinge_prior(hinge: Array, slip: float) -> Array:
    """[6 6] weak belief that a joint turns by some degrees and leaves its hinge [3] in place."""
    turn = 0.15
    x, y, z = hinge
    drag = np.array([[0, z, -y, 1, 0, 0], [-z, 0, x, 0, 1, 0], [y, -x, 0, 0, 0, 1]])
    out = drag.T @ drag / slip**2
    out[:3, :3] += np.eye(3) / turn**2
    return out
