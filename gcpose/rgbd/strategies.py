"""Ways to a solution: many starts on the first frames, few survivors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..chain import Hypothesis, distinct
from ..images import Flow
from ..numerics import together
from .depth_sweep import swept
from .refine import MIDDLING, descended
from .starts import beginnings
from .tracker import Tracker

_WIDE = (16.0, 8.0, 4.0, 2.0)


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
    return together(lambda h: tracker.settle(h, 1, MIDDLING), distinct(found, 6))


def by_sweeps(coarse: Tracker, flow: Flow) -> list[Hypothesis]:
    """Where the axes' lines are not known."""
    end = coarse.surfaces.frames - 1
    tasks = (lambda: swept(coarse, 1, 20), lambda: swept(coarse, min(3, end), 20),
             lambda: beginnings(coarse, flow, (2, 4), 6))
    return grown(coarse, [h for some in together(lambda t: t(), tasks) for h in some], 4, 1)


def by_more_sweeps(coarse: Tracker, flow: Flow) -> list[Hypothesis]:
    """The same from more starts, more of which are kept for longer."""
    end = coarse.surfaces.frames - 1
    some = together(lambda t: swept(coarse, min(t, end), 24), (1, 2, 3, 4))
    return grown(coarse, [h for found in some for h in found], 5, 2)


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
    found = together(lambda h: coarse.settle(h, 1, MIDDLING), distinct(found, 8 * keep))
    found = together(lambda h: coarse.follow(h, min(8, end)), distinct(found, 6 * keep))
    return together(lambda h: descended(coarse, h, 2, MIDDLING), distinct(found, 6 * keep))


def by_flow(coarse: Tracker, flow: Flow) -> list[Hypothesis]:
    """The same from flow alone, with axes that are free from the beginning."""
    end = coarse.surfaces.frames - 1
    found = beginnings(coarse, flow, (1, 2, 4), 6)
    found = together(lambda h: coarse.settle(extend(h, min(2, end)), 2, _WIDE), found)
    found = together(lambda h: coarse.follow(h, min(4, end)), distinct(found, 24))
    found = together(lambda h: coarse.settle(h, 1, MIDDLING), distinct(found, 16))
    found = together(lambda h: coarse.follow(h, min(7, end)), distinct(found, 10))
    return together(lambda h: coarse.settle(h, 2, MIDDLING), distinct(found, 6))


def extend(guess: Hypothesis, until: int) -> Hypothesis:
    """Go on evenly to frame `until`."""
    angle = guess.state.angle[: until + 1]
    while len(angle) <= until:
        angle = np.concatenate([angle, 2 * angle[-1:] - angle[-2:-1]])
    return replace(guess, state=replace(guess.state, angle=angle))
