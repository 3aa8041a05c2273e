"""Where the search begins: parts cut in many ways, their motion from flow and depth (Sec. 3.3)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, se3
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
from ..images import Flow, smooth_costs
from ..numerics import together
from .flow_motion import Correspondence, correspond, costs, fit
from .labels import Candidates
from .settings import RgbdSettings
from .tracker import Tracker


def beginnings(tracker: Tracker, flow: Flow, spans: tuple[int, ...], most: int) -> list[Hypothesis]:
    """The best starts by flow from frame 0 over each of `spans` frames."""
    grid, known, rank = tracker.grid(0), tracker.known, tracker.ranks[0]
    origin = grid.point[tracker.moving].mean(axis=0)
    settings = tracker.settings
    first = starts(rank, tracker.moving, len(known.prismatic), settings.start.cuts)
    found: list[Hypothesis] = []
    for span in spans:
        to = min(span, tracker.surfaces.frames - 1)
        field = flow(tracker.rgb[0], tracker.rgb[to])
        field = field[grid.pixel[:, 1], grid.pixel[:, 0]].astype(np.float64)
        data = correspond(tracker.surfaces, grid, field, to, origin, settings.start)
        slips = settings.start.hinge_slacks
        for slip in slips if known.freedom else slips[:1]:
            begin = Beginning(data, grid, tracker.bases[0], known, origin, to, slip, settings)
            found += distinct(together(begin.motion, first), most, settings.chain.distinct_labels)
    return found


def starts(
    rank: Array, moving: NDArray[np.bool_], joints: int, cuts: tuple[float, ...]
) -> list[NDArray[np.int64]]:
    """Initial labels: moving points cut into J runs from the base outward, in many ways."""
    return [
        np.where(moving, 1 + np.searchsorted(np.array(some), rank), 0)
        for some in combinations(cuts, joints - 1)
    ]


@dataclass(frozen=True)
class Beginning:
    """Frames 0 and `to`, between which motion is sought."""

    data: Correspondence
    grid: Candidates
    base: Array
    """[3] where the chain begins, m"""
    known: Known
    origin: Array
    """[3] about which twists are, m"""
    to: int
    slip: float
    """Standard deviation of a hinge's displacement, by the object's extent."""
    settings: RgbdSettings

    def motion(self, label: NDArray[np.int64]) -> Hypothesis:
        """EM from initial labels [N]; the displacement goes on evenly."""
        grid, known, settings, tuned = self.grid, self.known, self.settings, self.settings.start
        joints, origin = len(known.prismatic), self.origin
        space = tuple(about(origin, s.T).T for s in spaces(known))
        added = [np.zeros(6)] * joints
        moves = carriers(known.parent)
        inside = grid.point[label > 0]
        scale = extent(inside, settings.chain) if len(inside) else 1.0
        cost = np.inf
        at = hinges(grid.point, label, self.base, known.parent, settings.chain)
        for _ in range(tuned.rounds):
            at = hinges(grid.point, label, self.base, known.parent, settings.chain)
            prior = np.stack([hinge_prior(p - origin, self.slip * scale, tuned.turn_sigma)
                              for p in at])
            added = fit(self.data, label, space, prior, moves, tuned.robust_scales)
            volume = smooth_costs(costs(self.data, added, moves, tuned), grid)
            label = volume.argmin(axis=1)
            cost = float(volume.min(axis=1).mean())
        twist, angle = np.zeros((joints, 6)), np.zeros((self.to + 1, joints))
        for j in range(joints):
            z = about(-origin, added[j])
            twist[j], end = axis_from(z, known, j, at[j], tuned.min_turn,
                                      settings.chain.max_axis_offset)
            angle[:, j] = np.linspace(0, end, self.to + 1)
        cloud = Cloud(0, grid.point, grid.normal, label)
        state = Articulation(twist, angle, known.prismatic, known.parent)
        return Hypothesis(state, (cloud,), cost)


def hinge_prior(hinge: Array, slip: float, turn: float) -> Array:
    """[6 6] weak belief that a joint turns by some degrees and leaves its hinge [3] in place."""
    drag = np.concatenate([-se3.hat(hinge), np.eye(3)], axis=1)  # of twists (w, v)
    out = drag.T @ drag / slip**2
    out[:3, :3] += np.eye(3) / turn**2
    return out
