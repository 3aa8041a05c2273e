"""The choice among hypotheses: many on the first frames, few on all, and the best of these."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..chain import displace_axis
from ..estimator import align_displacements, select_distinct
from ..images import Flow
from ..numerics import thread_map
from .chain_from_motion import chains_from_motion
from .depth_sweep import sweep_depth
from .settings import RgbdSettings
from .starts import start_from_flow
from .strategies import Stage, Strategy
from .tracker import DepthHypothesis, Tracker, select_by_labels


def search_hypotheses(tracker: Tracker, flow: Flow) -> DepthHypothesis:
    """Return the best hypothesis over all frames; strategies are tried until one explains it."""
    free, settings = tracker.priors.axis_dof > 0, tracker.settings
    tuned, coarse = settings.search, tracker
    strategies = settings.known_lines, settings.known_lines_more
    if free:
        coarse = tracker.coarser(tuned.coarse_candidates)
        strategies = settings.free_sweeps, settings.free_flow, settings.free_sweeps_more
    tried: list[DepthHypothesis] = []
    for strategy in strategies:
        found = run_strategy(strategy, coarse, flow)
        if free:
            best_few = select_by_labels(found, tuned.relabeled, settings)
            found = [tracker.relabel(h, h.state) for h in best_few]
        best = refine_sharply(tracker, polish(tracker, found))
        again = bool(tried) and motion_difference(
            best, best_of(tried, settings), settings) < tuned.same_angle
        if free:
            best = try_other_chains(tracker, coarse, best)
        tried.append(best)
        most = unreliable_share(tracker) if again else poor_share(tracker)
        if is_explained(tracker, best_of(tried, settings), most):
            break
    return refine_without_flow(tracker, best_of(tried, settings))


def run_strategy(strategy: Strategy, tracker: Tracker, flow: Flow) -> list[DepthHypothesis]:
    """Make the starts of a strategy, and take the best through its stages."""
    end = tracker.surfaces.frames - 1
    makers: list[Callable[[], list[DepthHypothesis]]] = [
        partial(sweep_depth, tracker, min(span, end), strategy.sweep_kept)
        for span in strategy.sweep_spans]
    if strategy.flow_spans:
        makers.append(partial(start_from_flow, tracker, flow, strategy))
    found = [h for some in thread_map(lambda make: make(), makers) for h in some]
    if strategy.extend_to:
        found = [extrapolate_to(h, min(strategy.extend_to, end)) for h in found]
    for stage in strategy.stages:
        if stage.kept:
            found = select_by_labels(found, stage.kept, tracker.settings)
        found = thread_map(partial(run_stage, tracker, stage), found)
    return found


def run_stage(tracker: Tracker, stage: Stage, hypothesis: DepthHypothesis) -> DepthHypothesis:
    """Take a hypothesis through a stage."""
    if stage.until:
        until = min(stage.until, tracker.surfaces.frames - 1)
        return tracker.track(hypothesis, until, stage.scales, stage.fixed_axes)
    if stage.accelerated:
        return refine_until_stable(tracker, hypothesis, stage.rounds, stage.scales)
    return tracker.run_em(hypothesis, stage.rounds, stage.scales, stage.fixed_axes)


def extrapolate_to(hypothesis: DepthHypothesis, until: int) -> DepthHypothesis:
    """Extrapolate the displacements linearly to frame `until`, or cut them there."""
    angle = hypothesis.state.angle[: until + 1]
    while len(angle) <= until:
        angle = np.concatenate([angle, 2 * angle[-1:] - angle[-2:-1]])
    return replace(hypothesis, state=replace(hypothesis.state, angle=angle))


def refine_until_stable(
    tracker: Tracker, hypothesis: DepthHypothesis, rounds: int, scales: tuple[float, ...] = (),
    width: float = 1.0,
) -> DepthHypothesis:
    """Run EM (see `Tracker.run_em`) until the displacements stop changing.

    Labels and axes may creep along together. While they do, each round is also tried as an
    extrapolation.
    """
    tuned = tracker.settings.refine
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


def extrapolate(before: DepthHypothesis, after: DepthHypothesis, times: float) -> DepthHypothesis:
    """Return the hypothesis `times` as far from the first one as the second."""
    one, two = before.state, after.state
    angle = one.angle + times * (two.angle - one.angle)
    twist = np.stack([
        displace_axis(t + times * (u - t), np.zeros(6), bool(p))
        for t, u, p in zip(one.twist, two.twist, one.prismatic, strict=True)
    ])
    return replace(after, state=replace(two, angle=angle, twist=twist))


def refine_sharply(tracker: Tracker, best: DepthHypothesis) -> DepthHypothesis:
    """Refine with small robust scales where depth is exact: that reaches the end of flat valleys,
    and separates parts that move almost alike."""
    if tracker.surfaces.noise:
        return best
    tuned = tracker.settings.refine
    return refine_until_stable(tracker, best, tuned.sharp_rounds, tuned.sharp_scales,
                               tuned.sharp_width)


def refine_without_flow(tracker: Tracker, best: DepthHypothesis) -> DepthHypothesis:
    """Refine by depth alone where depth has noise: without texture, flow is too short."""
    if tracker.surfaces.flow is None:
        return best
    tuned = tracker.settings.refine
    return refine_until_stable(tracker.without_flow(), best, tuned.rounds, tuned.noisy_scales)


def polish(tracker: Tracker, found: list[DepthHypothesis]) -> DepthHypothesis:
    """Track the best hypotheses to the last frame, and refine the best of them."""
    tuned = tracker.settings
    found = select_by_labels(found, tuned.search.polished, tuned)
    found = thread_map(lambda h: tracker.track(h, tracker.surfaces.frames - 1), found)
    found = select_by_labels(found, tuned.search.refined, tuned)
    found = thread_map(lambda h: tracker.run_em(h, 1), found)
    return refine_until_stable(tracker, min(found, key=lambda h: h.cost), tuned.refine.rounds)


def try_other_chains(tracker: Tracker, coarse: Tracker, best: DepthHypothesis) -> DepthHypothesis:
    """Replace a doubtful hypothesis by a better chain that moves the surest part alike."""
    settings, tuned = tracker.settings, tracker.settings.search
    for _ in range(tuned.jumps):
        if is_explained(tracker, best, tuned.doubtful):
            break
        other = best_other_chain(tracker, coarse, best)
        if hypothesis_cost(other, settings) >= tuned.jump_cost * hypothesis_cost(best, settings):
            break
        best = other
    return best


def best_other_chain(tracker: Tracker, coarse: Tracker, best: DepthHypothesis) -> DepthHypothesis:
    """Refine other chains with the same part motion; return the best, or the present one."""
    settings, tuned = tracker.settings, tracker.settings.search
    found = thread_map(partial(coarse.relabel, best), chains_from_motion(tracker, best))
    found = select_by_motion(found, tuned.tried, settings)
    found = thread_map(lambda h: refine_until_stable(coarse, h, tuned.tried_rounds), found)
    found = [tracker.relabel(h, h.state)
             for h in select_by_motion(found, tuned.tried_fully, settings)]
    found = thread_map(lambda h: refine_until_stable(tracker, h, tuned.tried_fully_rounds), found)
    most = np.inf
    if not is_unreliable(tracker, best):
        most = tuned.promising_cost * tracker.relabel(best, best.state).cost
    found = [h for h in select_by_motion(found, tuned.tried_sharply, settings) if h.cost < most]
    return best_of([best, *thread_map(partial(refine_sharply, tracker), found)], settings)


def select_by_motion(
    found: list[DepthHypothesis], most: int, settings: RgbdSettings
) -> list[DepthHypothesis]:
    """Return the `most` best hypotheses whose last displacements differ."""
    def differ(one: DepthHypothesis, two: DepthHypothesis) -> bool:
        return motion_difference(one, two, settings) > settings.search.distinct_angle

    return select_distinct(found, most, differ)


def motion_difference(one: DepthHypothesis, two: DepthHypothesis, settings: RgbdSettings) -> float:
    """Return the largest difference of a last displacement, rad; a slide counts as a turn on an
    arm."""
    arm = np.where(one.state.prismatic, settings.chain.slide_arm, 1.0)
    apart = one.state.angle[-1] - align_displacements(one.state, two.state)[-1]
    return float((np.abs(apart) / arm).max())


def best_of(found: list[DepthHypothesis], settings: RgbdSettings) -> DepthHypothesis:
    """Return the hypothesis with the lowest score."""
    return min(found, key=partial(hypothesis_cost, settings=settings))


def hypothesis_cost(hypothesis: DepthHypothesis, settings: RgbdSettings) -> float:
    """Return the cost with a penalty for static joints, variances by frame; lower is better.

    All scored joints move, and motion can often be shared among joints at equal cost.
    """
    penalty = settings.search.static_penalty * has_static_joint(hypothesis, settings)
    return hypothesis.cost * (1 + penalty)


def has_static_joint(hypothesis: DepthHypothesis, settings: RgbdSettings) -> bool:
    """Return whether a joint hardly moves."""
    arm = np.where(hypothesis.state.prismatic, settings.chain.slide_arm, 1.0)
    largest = np.abs(hypothesis.state.angle).max(axis=0) / arm
    return bool(largest.min() < settings.search.static_angle)


def is_explained(tracker: Tracker, hypothesis: DepthHypothesis, most: float) -> bool:
    """Return whether all joints move, and less than a share of the candidates is unexplained."""
    return (tracker.unexplained_share(hypothesis) < most
            and not has_static_joint(hypothesis, tracker.settings))


def is_unreliable(tracker: Tracker, hypothesis: DepthHypothesis) -> bool:
    """Return whether more candidates are unexplained than as a rule by the true motion."""
    return tracker.unexplained_share(hypothesis) > unreliable_share(tracker)


def poor_share(tracker: Tracker) -> float:
    """Return the unexplained share above which another strategy is tried."""
    tuned, noisy = tracker.settings.search, tracker.surfaces.noise > 0
    if tracker.priors.axis_dof:
        return tuned.poor_noisy if noisy else tuned.poor
    return tuned.poor_known_lines_noisy if noisy else tuned.poor_known_lines


def unreliable_share(tracker: Tracker) -> float:
    """Return the unexplained share above which an estimate is unreliable."""
    tuned = tracker.settings.search
    return tuned.unreliable_noisy if tracker.surfaces.noise else tuned.unreliable
