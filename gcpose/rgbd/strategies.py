"""Ways to a solution: many starts on the first frames, few survivors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..chain import Hypothesis, distinct
from ..images import Flow
from ..numerics import together
from .depth_sweep import swept
from .refine import descended
from .settings import Stage, Strategy
from .starts import beginnings
from .tracker import Tracker


def pursue(strategy: Strategy, tracker: Tracker, flow: Flow) -> list[Hypothesis]:
    """Make the starts of a strategy and take the best through its stages."""
    end, difference = tracker.surfaces.frames - 1, tracker.settings.chain.distinct_labels
    begin: list[Callable[[], list[Hypothesis]]] = [
        partial(swept, tracker, min(span, end), strategy.sweep_kept)
        for span in strategy.sweep_spans]
    if strategy.flow_spans:
        begin.append(lambda: beginnings(tracker, flow, strategy.flow_spans, strategy.flow_kept))
    found = [h for some in together(lambda b: b(), begin) for h in some]
    if strategy.extend_to:
        found = [extend(h, min(strategy.extend_to, end)) for h in found]
    for stage in strategy.stages:
        if stage.kept:
            found = distinct(found, stage.kept, difference)
        found = together(partial(advance, tracker, stage), found)
    return found


def advance(tracker: Tracker, stage: Stage, guess: Hypothesis) -> Hypothesis:
    """Take a hypothesis through a stage."""
    if stage.until:
        until = min(stage.until, tracker.surfaces.frames - 1)
        return tracker.follow(guess, until, stage.scales, held=stage.fixed_axes)
    if stage.accelerated:
        return descended(tracker, guess, stage.rounds, stage.scales)
    return tracker.settle(guess, stage.rounds, stage.scales, held=stage.fixed_axes)


def extend(guess: Hypothesis, until: int) -> Hypothesis:
    """Go on evenly to frame `until`."""
    angle = guess.state.angle[: until + 1]
    while len(angle) <= until:
        angle = np.concatenate([angle, 2 * angle[-1:] - angle[-2:-1]])
    return replace(guess, state=replace(guess.state, angle=angle))
