"""Starts from optical flow and depth (Sec. 3.3): many initial labels, and EM between two frames."""

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
    JointPriors,
    ancestors,
    axis_from_twist,
    extent,
    locate_hinges,
    select_by_labels,
    twist_about,
    twist_spaces,
)
from ..images import Flow, smooth_costs
from ..numerics import thread_map
from .flow_motion import Correspondence, fit_twists, linearize_flow, match_costs
from .labels import Candidates
from .settings import RgbdSettings, Strategy
from .tracker import Tracker


def start_from_flow(tracker: Tracker, flow: Flow, strategy: Strategy) -> list[Hypothesis]:
    """Return the best starts of a strategy by flow from frame 0 over each of its spans."""
    grid, priors, settings = tracker.grid(0), tracker.priors, tracker.settings
    origin = grid.point[tracker.moving].mean(axis=0)
    labels = initial_labels(tracker.ranks[0], tracker.moving, len(priors.prismatic),
                            settings.start.cuts)
    slacks = settings.start.hinge_slacks if priors.axis_dof else settings.start.hinge_slacks[:1]
    found: list[Hypothesis] = []
    for span in strategy.flow_spans:
        to = min(span, tracker.surfaces.frames - 1)
        field = flow(tracker.rgb[0], tracker.rgb[to])
        field = field[grid.pixel[:, 1], grid.pixel[:, 0]].astype(np.float64)
        data = linearize_flow(tracker.surfaces, grid, field, to, origin, settings.start)
        for slack in slacks:
            start = FlowStart(data, grid, tracker.base_candidates[0], priors, origin, to, slack,
                              settings)
            found += select_by_labels(thread_map(start.solve, labels), strategy.flow_kept,
                                      settings.chain.distinct_labels)
    return found


def initial_labels(
    rank: Array, moving: NDArray[np.bool_], joints: int, cuts: tuple[float, ...]
) -> list[NDArray[np.int64]]:
    """Return labels [N] that cut the moving points by geodesic rank [N] into J parts, for every
    choice of cuts."""
    return [
        np.where(moving, 1 + np.searchsorted(np.array(some), rank), 0)
        for some in combinations(cuts, joints - 1)
    ]


@dataclass(frozen=True)
class FlowStart:
    """Frames 0 and `to`, between which a motion is estimated."""

    data: Correspondence
    grid: Candidates
    base: Array
    """[3] where the chain begins, m"""
    priors: JointPriors
    origin: Array
    """[3] about which twists are, m"""
    to: int
    slack: float
    """Standard deviation of a hinge's displacement, by the object's extent"""
    settings: RgbdSettings

    def solve(self, label: NDArray[np.int64]) -> Hypothesis:
        """Run EM from initial labels [N]; displacements between the frames are interpolated."""
        grid, priors = self.grid, self.priors
        tuned, chain = self.settings.start, self.settings.chain
        joints, origin = len(priors.prismatic), self.origin
        spaces = tuple(twist_about(origin, s.T).T for s in twist_spaces(priors))
        moves = ancestors(priors.parent)
        inside = grid.point[label > 0]
        sigma = self.slack * (extent(inside, chain) if len(inside) else 1.0)
        added, cost, hinge = [np.zeros(6)] * joints, np.inf, np.zeros((joints, 3))
        for _ in range(tuned.rounds):
            hinge = locate_hinges(grid.point, label, self.base, priors.parent, chain)
            prior = np.stack([joint_information(p - origin, sigma, tuned.turn_sigma)
                              for p in hinge])
            added = fit_twists(self.data, label, spaces, prior, moves, tuned.robust_scales)
            volume = smooth_costs(match_costs(self.data, added, moves, tuned), grid)
            label = volume.argmin(axis=1)
            cost = float(volume.min(axis=1).mean())
        twist, angle = np.zeros((joints, 6)), np.zeros((self.to + 1, joints))
        for j in range(joints):
            twist[j], end = axis_from_twist(twist_about(-origin, added[j]), priors, j, hinge[j],
                                            tuned.min_turn, chain.max_axis_offset)
            angle[:, j] = np.linspace(0, end, self.to + 1)
        cloud = Cloud(0, grid.point, grid.normal, label)
        state = Articulation(twist, angle, priors.prismatic, priors.parent)
        return Hypothesis(state, (cloud,), cost)


def joint_information(hinge: Array, slip: float, turn: float) -> Array:
    """Return the information [6 6] of a twist (w, v) that moves its hinge [3] by `slip` and turns
    by `turn` (standard deviations, m and rad)."""
    velocity = np.concatenate([-se3.hat(hinge), np.eye(3)], axis=1)  # of the hinge
    out = velocity.T @ velocity / slip**2
    out[:3, :3] += np.eye(3) / turn**2
    return out
