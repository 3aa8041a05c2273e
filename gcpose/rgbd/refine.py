"""The way down from a hypothesis: EM over all its frames, until it stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..chain import Hypothesis, displace_axis
from .tracker import Tracker


def descended(
    tracker: Tracker,
    guess: Hypothesis,
    rounds: int,
    scales: tuple[float, ...] = (),
    sharp: float = 1.0,
) -> Hypothesis:
    """EM until it stands; where labels and axes creep along together, by leaps."""
    tuned = tracker.settings.refine
    scales = scales or tuned.scales
    loose = tuned.noisy_factor if tracker.surfaces.noise else 1.0
    for _ in range(rounds):
        after = tracker.settle(guess, 1, scales, sharp=sharp)
        change = float(np.abs(after.state.angle - guess.state.angle).max())
        if change > tuned.creep * loose:
            leap = tracker.settle(leaped(guess, after, tuned.leap), 1, scales, sharp=sharp)
            after = min(after, leap, key=lambda h: h.cost)
        guess = after
        if change < tuned.stop * loose:
            break
    return guess


def leaped(before: Hypothesis, after: Hypothesis, times: float) -> Hypothesis:
    """The step from one hypothesis to the next, taken `times` as far."""
    one, two = before.state, after.state
    angle = one.angle + times * (two.angle - one.angle)
    twist = np.stack([
        displace_axis(t + times * (u - t), np.zeros(6), bool(p))
        for t, u, p in zip(one.twist, two.twist, one.prismatic, strict=True)
    ])
    return replace(after, state=replace(two, angle=angle, twist=twist))


def sharpened(tracker: Tracker, best: Hypothesis) -> Hypothesis:
    """Where depth is exact, it is weighed as such: flat valleys are walked to their ends, and
    labels and costs tell parts apart that move almost alike."""
    if tracker.surfaces.noise:
        return best
    tuned = tracker.settings.refine
    return descended(tracker, best, tuned.sharp_rounds, tuned.sharp_scales, tuned.sharp_width)


def refined(tracker: Tracker, best: Hypothesis) -> Hypothesis:
    """Where depth is noisy: by depth alone at the end, as flow sees too little motion where there
    is no texture."""
    if tracker.surfaces.flow is None:
        return best
    tuned = tracker.settings.refine
    return descended(tracker.flowless(), best, tuned.rounds, tuned.noisy_scales)
