"""The choice among hypotheses: many starts, few survivors, what explains all frames best."""

from __future__ import annotations

import numpy as np

from ..chain import ARM, Articulation, Hypothesis, distinct
from ..images import Flow
from ..numerics import together
from .chain_from_motion import factored
from .refine import ROUNDS, SHARPEST, descended, refined, sharpened
from .strategies import by_flow, by_lines, by_more_lines, by_more_sweeps, by_sweeps
from .tracker import Tracker

_COARSE = 500  # candidates that hard starts are judged on
_DOUBTFUL = 0.025  # of the candidates not explained: other chains are tried
_POOR = {0: (0.045, 0.03), 2: (0.08, 0.05), 4: (0.08, 0.05)}  # another way is; with noise
_LOST = 0.11, 0.09  # an estimate is not to be trusted; with noise
_OTHERS, _BETTER = 10, 4  # chains that are tried, and are tried on all candidates
_UNLIKE = np.radians(12.0)  # how far they are apart
_PROMISING = 1.3  # times the cost of what is there before it is sharpened
_ALIKE = np.radians(1.0)  # of solutions that are one
_IDLE, _STILL = 0.05, np.radians(5.0)  # of the cost; of a displacement
_JUMPS, _CHEAPER = 3, 0.99  # to other chains, and what is worth one


def search(tracker: Tracker, flow: Flow) -> Hypothesis:
    """The best hypothesis over all frames, from many starts on the first ones.

    Many are judged on few points and frames, few on all.
    """
    freedom = tracker.known.freedom
    coarse = tracker.thinned(_COARSE) if freedom else tracker
    ways = (by_sweeps, by_flow, by_more_sweeps) if freedom else (by_lines, by_more_lines)
    noisy = tracker.surfaces.noise > 0
    tried: list[Hypothesis] = []
    for way in ways:
        found = way(coarse, flow)
        if freedom:
            found = [tracker.relabel(h.state, tuple(c.frame for c in h.clouds), h.order)
                     for h in distinct(found, 4)]
        best = sharpened(tracker, polished(tracker, distinct(found, 3)))
        again = bool(tried) and apart(best, min(tried, key=badness)) < _ALIKE
        if freedom:
            best = bettered(tracker, coarse, best)
        tried.append(best)
        best = min(tried, key=badness)
        most = _LOST if again else _POOR[freedom]
        if unexplained(tracker, best) < most[noisy] and not idle(best):
            break
    return refined(tracker, min(tried, key=badness))


def bettered(tracker: Tracker, coarse: Tracker, best: Hypothesis) -> Hypothesis:
    """The best of a doubtful hypothesis and of other chains that move the surest part alike."""
    for _ in range(_JUMPS):
        if unexplained(tracker, best) < _DOUBTFUL and not idle(best):
            break
        other = jumped(tracker, coarse, best)
        if badness(other) >= _CHEAPER * badness(best):
            break
        best = other
    return best


def jumped(tracker: Tracker, coarse: Tracker, best: Hypothesis) -> Hypothesis:
    """The best other chain, at the bottom of its valley."""
    frames = tuple(c.frame for c in best.clouds)

    def seen(state: Articulation) -> Hypothesis:
        return coarse.relabel(state, frames, best.order)

    found = unlike(together(seen, factored(tracker, best)), _OTHERS)
    found = together(lambda h: descended(coarse, h, 2), found)
    found = [tracker.relabel(h.state, frames, h.order) for h in unlike(found, _BETTER)]
    found = together(lambda h: descended(tracker, h, ROUNDS // 2), found)
    most = np.inf
    if not lost(tracker, best):
        most = _PROMISING * tracker.relabel(best.state, frames, best.order).cost
    found = together(lambda h: sharpened(tracker, h),
                     [h for h in unlike(found, 3) if h.cost < most])
    return min([best, *found], key=badness)


def unlike(found: list[Hypothesis], most: int) -> list[Hypothesis]:
    """The best few whose displacements differ at the end."""
    out: list[Hypothesis] = []
    for h in sorted(found, key=lambda h: h.cost):
        if all(apart(h, other) > _UNLIKE for other in out):
            out.append(h)
        if len(out) == most:
            break
    return out


def apart(one: Hypothesis, two: Hypothesis) -> float:
    """Largest difference of a displacement at the end, rad; a slide counts as a turn on an arm.

    An axis that points the other way is the same axis.
    """
    a, b = one.state, two.state
    arm = np.where(a.prismatic, ARM, 1.0)
    directions = [np.where(s.prismatic[:, None], s.twist[:, 3:], s.twist[:, :3]) for s in (a, b)]
    sign = np.where((directions[0] * directions[1]).sum(axis=1) < 0, -1.0, 1.0)
    return float((np.abs(a.angle[-1] - sign * b.angle[-1]) / arm).max())


def badness(guess: Hypothesis) -> float:
    """Its cost, and a little more where a joint stands still: all were said to move, and what one
    part does can often be shared among joints in other ways that cost the same."""
    return guess.cost * (1 + _IDLE * idle(guess))


def idle(guess: Hypothesis) -> bool:
    """Whether a joint hardly moves."""
    arm = np.where(guess.state.prismatic, ARM, 1.0)
    return bool((np.abs(guess.state.angle).max(axis=0) / arm).min() < _STILL)


def lost(tracker: Tracker, guess: Hypothesis) -> bool:
    """Whether more is unexplained than the truth hardly ever leaves."""
    return unexplained(tracker, guess) > _LOST[tracker.surfaces.noise > 0]


def unexplained(tracker: Tracker, guess: Hypothesis) -> float:
    """Share of the candidates."""
    return tracker.unexplained(guess, 1.0 if tracker.surfaces.noise else SHARPEST)


def polished(tracker: Tracker, found: list[Hypothesis]) -> Hypothesis:
    """The best over all frames, at the bottom of its valley."""
    found = together(lambda h: tracker.follow(h, tracker.surfaces.frames - 1), found)
    found = together(lambda h: tracker.settle(h, 1), distinct(found, 3))
    return descended(tracker, min(found, key=lambda h: h.cost), ROUNDS)
