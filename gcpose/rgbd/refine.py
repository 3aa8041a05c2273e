"""Refinement of a hypothesis: EM over all its frames until nothing changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..chain import Hypothesis, displace_axis
from .tracker import Tracker


def refine_until_stable(
    tracker: Tracker, hypothesis: Hypothesis, rounds: int, scales: tuple[float, ...] = (),
    width: float = 1.0,
) -> Hypothesis:
    """Run EM until the displacements stop changing.

    Labels and axes may creep along together. While they do, each round is also tried as an
    extrapolation.

    Args:
        tracker: The video.
        hypothesis: Where to begin.
        rounds: Rounds at most.
        scales: Robust scales of a round, footprints; default: as in the settings.
        width: Least standard deviation of a candidate's place, footprints.
    """
    tuned = tracker.settings.refine
    scales = scales or tuned.scales
    factor = tuned.noisy_factor if tracker.surfaces.noise else 1.0
    for _ in range(rounds):
        after = tracker.run_em(hypothesis, 1, scales, width=width)
        change = float(np.abs(after.state.angle - hypothesis.state.angle).max())
        if change > tuned.creep * factor:
            further = extrapolate(hypothesis, after, tuned.leap)
            further = tracker.run_em(further, 1, scales, width=width)
            after = min(after, further, key=lambda h: h.cost)
        hypothesis = after
        if change < tuned.stop * factor:
            break
    return hypothesis


def extrapolate(before: Hypothesis, after: Hypothesis, times: float) -> Hypothesis:
    """Return the hypothesis `times` as far from the first one as the second."""
    one, two = before.state, after.state
    angle = one.angle + times * (two.angle - one.angle)
    twist = np.stack([
        displace_axis(t + times * (u - t), np.zeros(6), bool(p))
        for t, u, p in zip(one.twist, two.twist, one.prismatic, strict=True)
    ])
    return replace(after, state=replace(two, angle=angle, twist=twist))


def refine_sharply(tracker: Tracker, best: Hypothesis) -> Hypothesis:
    """Refine with small robust scales where depth is exact.

    That reaches the end of flat valleys, and separates parts that move almost alike.
    """
    if tracker.surfaces.noise:
        return best
    tuned = tracker.settings.refine
    return refine_until_stable(tracker, best, tuned.sharp_rounds, tuned.sharp_scales,
                               tuned.sharp_width)


def refine_without_flow(tracker: Tracker, best: Hypothesis) -> Hypothesis:
    """Refine by depth alone where depth has noise: without texture, flow is too short."""
    if tracker.surfaces.flow is None:
        return best
    tuned = tracker.settings.refine
    return refine_until_stable(tracker.without_flow(), best, tuned.rounds, tuned.noisy_scales)
