"""The choice among hypotheses: many starts, few survivors, what explains all frames best."""

from __future__ import annotations

from .articulation import Articulation, Hypothesis, distinct
from .crew import together
from .descent import MIDDLING, ROUNDS, SHARPEST, descended, refined, sharpened
from .factor import factored
from .flow import Flow
from .tracker import Tracker
from .trade import traded
from .ways import by_flow, by_lines, by_more_lines, by_more_sweeps, by_sweeps

_COARSE = 500  # candidates that hard starts are judged on
_DOUBTFUL = 0.045, 0.03  # of the candidates not explained: another way is tried; with noise
_LOST = 0.11, 0.09  # the same, for an estimate not to be trusted
_JUMPED = 2, 1  # of the solutions that were tried; with noise
_JUMPS, _CHEAPER = 2, 0.99  # to other chains, and what is worth one


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
    found += together(lambda h: coarse.settle(h, 2, MIDDLING), some)
    found = together(lambda h: descended(coarse, h, 2, MIDDLING), distinct(found, 8))
    found = [tracker.relabel(h.state, frames, h.order) for h in distinct(found, 3)]
    found = together(lambda h: descended(tracker, h, ROUNDS // 2), found)
    found = together(lambda h: sharpened(tracker, h), found)
    return min([best, *found], key=lambda h: h.cost)


def doubtful(tracker: Tracker, guess: Hypothesis) -> bool:
    """Whether more is unexplained than the truth leaves as a rule."""
    return unexplained(tracker, guess) > _DOUBTFUL[tracker.surfaces.noise > 0]


def lost(tracker: Tracker, guess: Hypothesis) -> bool:
    """Whether more is unexplained than the truth ever left."""
    return unexplained(tracker, guess) > _LOST[tracker.surfaces.noise > 0]


def unexplained(tracker: Tracker, guess: Hypothesis) -> float:
    """Share of the candidates."""
    return tracker.unexplained(guess, 1.0 if tracker.surfaces.noise else SHARPEST)


def polished(tracker: Tracker, found: list[Hypothesis]) -> Hypothesis:
    """The best over all frames, at the bottom of its valley."""
    found = together(lambda h: tracker.follow(h, tracker.surfaces.frames - 1), found)
    found = together(lambda h: tracker.settle(h, 1), distinct(found, 3))
    return descended(tracker, min(found, key=lambda h: h.cost), ROUNDS)
