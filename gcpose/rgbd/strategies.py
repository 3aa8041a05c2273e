"""Initialization strategies: make hypotheses on the first frames and keep the best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..chain import Hypothesis, select_by_labels
from ..images import Flow
from ..numerics import thread_map
from .depth_sweep import sweep_depth
from .refine import refine_until_stable
from .settings import Stage, Strategy
from .starts import start_from_flow
from .tracker import Tracker


def run_strategy(strategy: Strategy, tracker: Tracker, flow: Flow) -> list[Hypothesis]:
    """Make the starts of a strategy, and take the best through its stages."""
    end, difference = tracker.surfaces.frames - 1, tracker.settings.chain.distinct_labels
    makers: list[Callable[[], list[Hypothesis]]] = [
        partial(sweep_depth, tracker, min(span, end), strategy.sweep_kept)
        for span in strategy.sweep_spans]
    if strategy.flow_spans:
        makers.append(partial(start_from_flow, tracker, flow, strategy))
    found = [h for some in thread_map(lambda make: make(), makers) for h in some]
    if strategy.extend_to:
        found = [extrapolate_to(h, min(strategy.extend_to, end)) for h in found]
    for stage in strategy.stages:
        if stage.kept:
            found = select_by_labels(found, stage.kept, difference)
        found = thread_map(partial(run_stage, tracker, stage), found)
    return found


def run_stage(tracker: Tracker, stage: Stage, hypothesis: Hypothesis) -> Hypothesis:
    """Take a hypothesis through a stage."""
    if stage.until:
        until = min(stage.until, tracker.surfaces.frames - 1)
        return tracker.track(hypothesis, until, stage.scales, stage.fixed_axes)
    if stage.accelerated:
        return refine_until_stable(tracker, hypothesis, stage.rounds, stage.scales)
    return tracker.run_em(hypothesis, stage.rounds, stage.scales, stage.fixed_axes)


def extrapolate_to(hypothesis: Hypothesis, until: int) -> Hypothesis:
    """Extrapolate the displacements linearly to frame `until`, or cut them there."""
    angle = hypothesis.state.angle[: until + 1]
    while len(angle) <= until:
        angle = np.concatenate([angle, 2 * angle[-1:] - angle[-2:-1]])
    return replace(hypothesis, state=replace(hypothesis.state, angle=angle))
