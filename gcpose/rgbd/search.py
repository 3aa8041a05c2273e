"""The choice among hypotheses: many starts, few survivors, what explains all frames best."""

from __future__ import annotations

import numpy as np

from ..chain import Articulation, Hypothesis, distinct
from ..images import Flow
from ..numerics import together
from .chain_from_motion import factored
from .refine import descended, refined, sharpened
from .settings import RgbdSettings
from .strategies import pursue
from .tracker import Tracker


def search(tracker: Tracker, flow: Flow) -> Hypothesis:
    """The best hypothesis over all frames, from many starts on the first ones.

    Many are judged on few points and frames, few on all.
    """
    freedom, settings = tracker.known.freedom, tracker.settings
    tuned, difference = settings.search, settings.chain.distinct_labels
    coarse, strategies = tracker, (settings.known_lines, settings.known_lines_more)
    if freedom:
        coarse = tracker.thinned(tuned.coarse_candidates)
        strategies = settings.free_sweeps, settings.free_flow, settings.free_sweeps_more
    tried: list[Hypothesis] = []
    for strategy in strategies:
        found = pursue(strategy, coarse, flow)
        if freedom:
            found = [tracker.relabel(h.state, tuple(c.frame for c in h.clouds), h.order)
                     for h in distinct(found, tuned.relabeled, difference)]
        best = sharpened(tracker, polished(tracker, distinct(found, tuned.polished, difference)))
        again = bool(tried) and apart(best, best_of(tried, settings), settings) < tuned.same_angle
        if freedom:
            best = bettered(tracker, coarse, best)
        tried.append(best)
        best = best_of(tried, settings)
        most = most_unexplained(tracker) if again else most_poor(tracker)
        if unexplained(tracker, best) < most and not idle(best, settings):
            break
    return refined(tracker, best_of(tried, settings))


def most_poor(tracker: Tracker) -> float:
    """Share of the candidates that may be unexplained without another strategy being tried."""
    tuned, noisy = tracker.settings.search, tracker.surfaces.noise > 0
    if tracker.known.freedom:
        return tuned.poor_noisy if noisy else tuned.poor
    return tuned.poor_known_lines_noisy if noisy else tuned.poor_known_lines


def most_unexplained(tracker: Tracker) -> float:
    """Share of the candidates that may be unexplained in a reliable estimate."""
    tuned = tracker.settings.search
    return tuned.unreliable_noisy if tracker.surfaces.noise else tuned.unreliable


def bettered(tracker: Tracker, coarse: Tracker, best: Hypothesis) -> Hypothesis:
    """The best of a doubtful hypothesis and of other chains that move the surest part alike."""
    settings, tuned = tracker.settings, tracker.settings.search
    for _ in range(tuned.jumps):
        if unexplained(tracker, best) < tuned.doubtful and not idle(best, settings):
            break
        other = jumped(tracker, coarse, best)
        if badness(other, settings) >= tuned.jump_cost * badness(best, settings):
            break
        best = other
    return best


def jumped(tracker: Tracker, coarse: Tracker, best: Hypothesis) -> Hypothesis:
    """The best other chain, at the bottom of its valley."""
    frames = tuple(c.frame for c in best.clouds)
    settings, tuned = tracker.settings, tracker.settings.search

    def seen(state: Articulation) -> Hypothesis:
        return coarse.relabel(state, frames, best.order)

    found = unlike(together(seen, factored(tracker, best)), tuned.tried, settings)
    found = together(lambda h: descended(coarse, h, tuned.tried_rounds), found)
    found = [tracker.relabel(h.state, frames, h.order)
             for h in unlike(found, tuned.tried_fully, settings)]
    found = together(lambda h: descended(tracker, h, tuned.tried_fully_rounds), found)
    most = np.inf
    if not lost(tracker, best):
        most = tuned.promising_cost * tracker.relabel(best.state, frames, best.order).cost
    found = together(lambda h: sharpened(tracker, h),
                     [h for h in unlike(found, tuned.tried_sharply, settings) if h.cost < most])
    return best_of([best, *found], settings)


def unlike(
    found: list[Hypothesis], most: int, settings: RgbdSettings
) -> list[Hypothesis]:
    """The best few whose displacements differ at the end."""
    out: list[Hypothesis] = []
    for h in sorted(found, key=lambda h: h.cost):
        if all(apart(h, other, settings) > settings.search.distinct_angle for other in out):
            out.append(h)
        if len(out) == most:
            break
    return out


def apart(one: Hypothesis, two: Hypothesis, settings: RgbdSettings) -> float:
    """Largest difference of a displacement at the end, rad; a slide counts as a turn on an arm.

    An axis that points the other way is the same axis.
    """
    a, b = one.state, two.state
    arm = np.where(a.prismatic, settings.chain.slide_arm, 1.0)
    directions = [np.where(s.prismatic[:, None], s.twist[:, 3:], s.twist[:, :3]) for s in (a, b)]
    sign = np.where((directions[0] * directions[1]).sum(axis=1) < 0, -1.0, 1.0)
    return float((np.abs(a.angle[-1] - sign * b.angle[-1]) / arm).max())


def best_of(found: list[Hypothesis], settings: RgbdSettings) -> Hypothesis:
    """The hypothesis with the least cost."""
    return min(found, key=lambda h: badness(h, settings))


def badness(guess: Hypothesis, settings: RgbdSettings) -> float:
    """Its cost, and a little more where a joint stands still: all were said to move, and what one
    part does can often be shared among joints in other ways that cost the same."""
    return guess.cost * (1 + settings.search.static_penalty * idle(guess, settings))


def idle(guess: Hypothesis, settings: RgbdSettings) -> bool:
    """Whether a joint hardly moves."""
    arm = np.where(guess.state.prismatic, settings.chain.slide_arm, 1.0)
    largest = np.abs(guess.state.angle).max(axis=0) / arm
    return bool(largest.min() < settings.search.static_angle)


def lost(tracker: Tracker, guess: Hypothesis) -> bool:
    """Whether more is unexplained than the truth hardly ever leaves."""
    return unexplained(tracker, guess) > most_unexplained(tracker)


def unexplained(tracker: Tracker, guess: Hypothesis) -> float:
    """Share of the candidates."""
    width = 1.0 if tracker.surfaces.noise else tracker.settings.refine.sharp_width
    return tracker.unexplained(guess, width)


def polished(tracker: Tracker, found: list[Hypothesis]) -> Hypothesis:
    """The best over all frames, at the bottom of its valley."""
    tuned, difference = tracker.settings, tracker.settings.chain.distinct_labels
    found = together(lambda h: tracker.follow(h, tracker.surfaces.frames - 1), found)
    found = distinct(found, tuned.search.settled, difference)
    found = together(lambda h: tracker.settle(h, 1), found)
    return descended(tracker, min(found, key=lambda h: h.cost), tuned.refine.rounds)
