"""The choice among hypotheses: many starts, few survivors, what explains all frames best."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from .articulation import ACROSS, ALONG, Hypothesis, distinct
from .flow import Flow
from .start import beginnings
from .tracker import Tracker

_COARSE = 500  # candidates that hard starts are judged on


def search(tracker: Tracker, flow: Flow) -> Hypothesis:
    """The best hypothesis over all frames, from many starts on the first ones.

    Many are judged on few points and frames, few on all. Where axes are unknown
    the first frames decide less: more are kept for longer.
    """
    end, known = tracker.surfaces.frames - 1, tracker.known
    hard = known.freedom > 0
    coarse = tracker.thinned(_COARSE) if hard else tracker
    wide, middling = (16.0, 8.0, 4.0, 2.0), (4.0, 4.0, 2.0, 2.0)
    found = beginnings(coarse, flow, (1, 2, 4) if hard else (1, 2), 6 if hard else 8)
    found = [coarse.settle(extend(h, min(2, end)), 2, wide) for h in found]
    if hard:
        found = [coarse.follow(h, min(4, end)) for h in distinct(found, 24)]
        found = [coarse.settle(h, 1, middling) for h in distinct(found, 16)]
        found = [coarse.follow(h, min(7, end)) for h in distinct(found, 10)]
        found = [coarse.settle(h, 2, middling) for h in distinct(found, 6)]
        found = [tracker.relabel(h.state, tuple(c.frame for c in h.clouds))
                 for h in distinct(found, 4)]
    else:
        found = [tracker.follow(h, min(5, end)) for h in distinct(found, 6)]
    found = [tracker.follow(h, end) for h in distinct(found, 3)]
    best = tracker.settle(distinct(found, 1)[0], 2)
    return squared(tracker, best) if known.freedom == 4 else best


def squared(tracker: Tracker, best: Hypothesis) -> Hypothesis:
    """Where directions are unknown: neighbouring axes at right angles or parallel, if they fit."""
    joints = len(best.state.prismatic)
    ways = [replace(best, state=replace(best.state, relation=way))
            for way in product((ACROSS, ALONG), repeat=joints - 1)]
    found = [best, *(tracker.settle(h, 3) for h in ways)]
    return min(found, key=lambda h: h.cost * (1.0 if h.state.relation else 1.05))


def extend(guess: Hypothesis, until: int) -> Hypothesis:
    """Go on evenly to frame `until`."""
    angle = guess.state.angle[: until + 1]
    while len(angle) <= until:
        angle = np.concatenate([angle, 2 * angle[-1:] - angle[-2:-1]])
    return replace(guess, state=replace(guess.state, angle=angle))
