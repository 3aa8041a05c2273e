"""The choice among hypotheses: many starts, few survivors, what explains all frames best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .articulation import Articulation, Hypothesis, distinct
from .chain import displace_axis
from .crew import together
from .factor import factored
from .flow import Flow
from .start import beginnings
from .sweep import swept
from .tracker import Tracker
from .trade import traded

_COARSE = 500  # candidates that hard starts are judged on
_WIDE, _MIDDLING = (16.0, 8.0, 4.0, 2.0), (4.0, 4.0, 2.0, 2.0)
_DOUBTFUL = 0.045, 0.03  # of the candidates not explained: another way is tried; with noise
_ROUNDS = 10  # of EM at the end, at most
_CREEPS, _STANDS = np.radians(0.1), np.radians(0.01)  # change of a displacement in a round
_JUMPED = 2, 1  # of the solutions that were tried; with noise
_JUMPS, _CHEAPER = 2, 0.99  # to other chains, and what is worth one
_SHARP = 0.5, 0.25, 0.12, 0.12
_SHARPEST = 0.12  # footprints, of labels and costs
_REFINED = 2.0, 1.0, 0.6, 0.4
_LOOSE = 6.0  # times as much with noise


def search(tracker: Tracker, flow: Flow) -> Hypothesis:
    """The best hypothesis over all frames, from many starts on the first ones.

    Many are judged on few points and frames, few on all.
    """
    freedom = tracker.known.freedom
    coarse = tracker.thinned(_COARSE) if freedom else tracker
    ways = (by_sweeps, by_more_sweeps, by_flow) if freedom else (by_lines, by_more_lines)
    tried: list[Hypothesis] = []
    for way in ways:
        found = way(coarse, flow)
        if freedom:
            found = [tracker.relabel(h.state, tuple(c.frame for c in h.clouds), h.order)
                     for h in distinct(found, 4)]
        tried.append(sharpened(tracker, polished(tracker, distinct(found, 3))))
        if not doubtful(tracker, min(tried, key=lambda h: h.cost)):
            break
    else:
        if freedom:
            most = _JUMPED[tracker.surfaces.noise > 0]
            tried += [bettered(tracker, coarse, h) for h in distinct(tried, most)]
    return refined(tracker, min(tried, key=lambda h: h.cost))


def refined(tracker: Tracker, best: Hypothesis) -> Hypothesis:
    """Where depth is noisy: by depth alone at the end, as flow sees too little motion where there
    is no texture."""
    if tracker.surfaces.flow is None:
        return best
    return descended(tracker.flowless(), best, _ROUNDS, _REFINED)


def sharpened(tracker: Tracker, best: Hypothesis) -> Hypothesis:
    """Where depth is exact, it is weighed as such: flat valleys are walked to their ends, and
    labels and costs tell parts apart that move almost alike."""
    if tracker.surfaces.noise:
        return best
    return descended(tracker, best, 2 * _ROUNDS, _SHARP, _SHARPEST)


def bettered(tracker: Tracker, coarse: Tracker, best: Hypothesis) -> Hypothesis:
    """The best of a hypothesis and of other chains that move the surest part as it does."""
    for _ in range(_JUMPS):
        other = jumped(tracker, coarse, best)
        if other.cost >= _CHEAPER * best.cost:
            break
        best = other
    return best


def jumped(tracker: Tracker, coarse: Tracker, best: Hypothesis) -> Hypothesis:
    """The best other chain, at the bottom of its valley."""
    frames = tuple(c.frame for c in best.clouds)

    def seen(state: Articulation) -> Hypothesis:
        return coarse.relabel(state, frames, best.order)

    found = together(lambda h: coarse.settle(h, 2, (8.0, 6.0, 4.0, 4.0)),
                     traded(coarse, seen(best.state), 8))
    some = distinct(together(seen, factored(tracker, best)), 24)
    found += together(lambda h: coarse.settle(h, 2, _MIDDLING), some)
    found = together(lambda h: descended(coarse, h, 2, _MIDDLING), distinct(found, 8))
    found = [tracker.relabel(h.state, frames, h.order) for h in distinct(found, 3)]
    found = together(lambda h: descended(tracker, h, _ROUNDS // 2), found)
    found = together(lambda h: sharpened(tracker, h), found)
    return min([best, *found], key=lambda h: h.cost)


def doubtful(tracker: Tracker, guess: Hypothesis) -> bool:
    """Whether more is unexplained than the truth leaves."""
    noisy = tracker.surfaces.noise > 0
    return tracker.unexplained(guess, 1.0 if noisy else _SHARPEST) > _DOUBTFUL[noisy]


def polished(tracker: Tracker, found: list[Hypothesis]) -> Hypothesis:
    """The best over all frames, at the bottom of its valley."""
    found = together(lambda h: tracker.follow(h, tracker.surfaces.frames - 1), found)
    found = together(lambda h: tracker.settle(h, 1), distinct(found, 3))
    return descended(tracker, min(found, key=lambda h: h.cost), _ROUNDS)


def descended(
    tracker: Tracker,
    guess: Hypothesis,
    rounds: int,
    scales: tuple[float, ...] = (4.0, 2.0, 1.0),
    sharp: float = 1.0,
) -> Hypothesis:
    """EM until it stands; where labels and axes creep along together, by leaps."""
    loose = _LOOSE if tracker.surfaces.noise else 1.0
    for _ in range(rounds):
        after = tracker.settle(guess, 1, scales, sharp=sharp)
        change = float(np.abs(after.state.angle - guess.state.angle).max())
        if change > _CREEPS * loose:
            leap = tracker.settle(leaped(guess, after, 4.0), 1, scales, sharp=sharp)
            after = min(after, leap, key=lambda h: h.cost)
        guess = after
        if change < _STANDS * loose:
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


def by_lines(tracker: Tracker, flow: Flow) -> list[Hypothesis]:
    """Where the axes' lines are known."""
    end = tracker.surfaces.frames - 1
    found = beginnings(tracker, flow, (1, 2), 4)
    found += swept(tracker, 1, 6) + swept(tracker, min(3, end), 6)
    found = together(lambda h: tracker.settle(extend(h, min(2, end)), 2, _WIDE), found)
    found = together(lambda h: tracker.follow(h, min(5, end)), distinct(found, 6))
    return distinct(found, 3)


def by_more_lines(tracker: Tracker, flow: Flow) -> list[Hypothesis]:
    """The same from more starts."""
    end = tracker.surfaces.frames - 1
    found = beginnings(tracker, flow, (4,), 6)
    for span in (1, 2, 4):
        found += swept(tracker, min(span, end), 16)
    found = together(lambda h: tracker.settle(h, 1, (8.0, 8.0, 6.0)), found)
    found = together(lambda h: tracker.follow(h, min(5, end)), distinct(found, 12))
    return together(lambda h: tracker.settle(h, 1, _MIDDLING), distinct(found, 6))


def by_sweeps(coarse: Tracker, flow: Flow) -> list[Hypothesis]:
    """Where the axes' lines are not known."""
    end = coarse.surfaces.frames - 1
    found = swept(coarse, 1, 20) + swept(coarse, min(3, end), 20)
    return grown(coarse, found + beginnings(coarse, flow, (2, 4), 6), 4, 1)


def by_more_sweeps(coarse: Tracker, flow: Flow) -> list[Hypothesis]:
    """The same from more starts, more of which are kept for longer."""
    end = coarse.surfaces.frames - 1
    return grown(coarse, [h for t in (1, 2, 3, 4) for h in swept(coarse, min(t, end), 24)], 5, 2)


def grown(coarse: Tracker, found: list[Hypothesis], hold: int, keep: int) -> list[Hypothesis]:
    """The best over some frames.

    A few frames do not tell where the axes are: up to frame `hold` they stay in the hinges.
    """
    end = coarse.surfaces.frames - 1
    found = together(lambda h: coarse.settle(h, 1, (8.0, 8.0, 6.0), held=True), found)
    found = distinct(found, 24 * keep)
    found = together(lambda h: coarse.follow(h, min(hold, end), (8.0, 6.0), held=True), found)
    found = together(lambda h: coarse.settle(h, 1, (8.0, 6.0, 4.0, 4.0)),
                     distinct(found, 16 * keep))
    found = together(lambda h: coarse.follow(h, min(6, end), (4.0, 3.0)),
                     distinct(found, 10 * keep))
    found = together(lambda h: coarse.settle(h, 1, _MIDDLING), distinct(found, 8 * keep))
    found = together(lambda h: coarse.follow(h, min(8, end)), distinct(found, 6 * keep))
    return together(lambda h: descended(coarse, h, 2, _MIDDLING), distinct(found, 6 * keep))


def by_flow(coarse: Tracker, flow: Flow) -> list[Hypothesis]:
    """The same from flow alone, with axes that are free from the beginning."""
    end = coarse.surfaces.frames - 1
    found = beginnings(coarse, flow, (1, 2, 4), 6)
    found = together(lambda h: coarse.settle(extend(h, min(2, end)), 2, _WIDE), found)
    found = together(lambda h: coarse.follow(h, min(4, end)), distinct(found, 24))
    found = together(lambda h: coarse.settle(h, 1, _MIDDLING), distinct(found, 16))
    found = together(lambda h: coarse.follow(h, min(7, end)), distinct(found, 10))
    return together(lambda h: coarse.settle(h, 2, _MIDDLING), distinct(found, 6))


def extend(guess: Hypothesis, until: int) -> Hypothesis:
    """Go on evenly to frame `until`."""
    angle = guess.state.angle[: until + 1]
    while len(angle) <= until:
        angle = np.concatenate([angle, 2 * angle[-1:] - angle[-2:-1]])
    return replace(guess, state=replace(guess.state, angle=angle))
