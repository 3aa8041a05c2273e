"""The choice among hypotheses: many on the first frames, few on all, and the best of these."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...errors import MethodError
from ...robots.geometry import Array
from ..chain import Articulation, displace_axis, extrapolate_to
from ..estimator import align_displacements, refine_in_stages, run_em, select_distinct
from ..images import Flow
from ..numerics import thread_map
from .chain_from_motion import chains_from_motion
from .depth_sweep import sweep_depth
from .evidence import DepthHypothesis, Labeling, RgbdEvidence
from .settings import RgbdSettings
from .starts import start_from_flow
from .strategies import Stage, Strategy


def search_hypotheses(evidence: RgbdEvidence, flow: Flow) -> DepthHypothesis:
    """Return the best hypothesis over all frames; strategies are tried until one explains it."""
    free, settings = evidence.priors.axis_dof > 0, evidence.settings
    tuned, coarse = settings.search, evidence
    strategies = settings.known_lines, settings.known_lines_more
    if free:
        coarse = evidence.coarser(tuned.coarse_candidates)
        strategies = settings.free_sweeps, settings.free_flow, settings.free_sweeps_more
    tried: list[DepthHypothesis] = []
    for strategy in strategies:
        found = run_strategy(strategy, coarse, flow)
        if not found:  # flow has no starts for very many joints
            continue
        if free:
            found = [evidence.label(h, Labeling())
                     for h in evidence.select(found, tuned.relabeled)]
        best = refine_sharply(evidence, polish(evidence, found))
        again = bool(tried) and motion_difference(
            best, best_of(tried, settings), settings) < tuned.same_angle
        if free:
            best = try_other_chains(evidence, coarse, best)
        tried.append(best)
        most = unreliable_share(evidence) if again else poor_share(evidence)
        if is_explained(evidence, best_of(tried, settings), most):
            break
    if not tried:
        raise MethodError(f"gcpose with depth finds no start for {len(evidence.priors.parent)} "
                          "joints; declare fewer")
    return refine_without_flow(evidence, best_of(tried, settings))


def run_strategy(strategy: Strategy, evidence: RgbdEvidence, flow: Flow) -> list[DepthHypothesis]:
    """Make the starts of a strategy, and take the best through its stages."""
    end = evidence.surfaces.frames - 1
    swept = thread_map(lambda span: sweep_depth(evidence, min(span, end), strategy.sweep_kept),
                       strategy.sweep_spans)
    found = [h for some in (*swept, start_from_flow(evidence, flow, strategy)) for h in some]
    if strategy.extend_to:
        to = min(strategy.extend_to, end)
        found = [replace(h, state=extrapolate_to(h.state, to)) for h in found]
    stages = ((stage.kept, partial(run_stage, evidence, stage)) for stage in strategy.stages)
    return refine_in_stages(found, evidence.select, *stages)


def run_stage(evidence: RgbdEvidence, stage: Stage, hypothesis: DepthHypothesis) -> DepthHypothesis:
    """Take a hypothesis through a stage."""
    if stage.until:
        until = min(stage.until, evidence.surfaces.frames - 1)
        return evidence.track(hypothesis, until, stage.scales, stage.fixed_axes)
    if stage.accelerated:
        return refine_until_stable(evidence, hypothesis, stage.rounds, stage.scales)
    em_round = evidence.em_round(stage.scales, stage.fixed_axes)
    return run_em(evidence, hypothesis, [em_round] * stage.rounds)


def refine_until_stable(
    evidence: RgbdEvidence, hypothesis: DepthHypothesis, rounds: int,
    scales: tuple[float, ...] = (), width: float = 1.0,
) -> DepthHypothesis:
    """Run EM until the displacements stop changing.

    Labels and axes may creep along together. While they do, each round is also tried as an
    extrapolation.
    """
    tuned = evidence.settings.refine
    factor = tuned.noisy_factor if evidence.surfaces.noise else 1.0
    em_round = [evidence.em_round(scales, width=width)]
    for _ in range(rounds):
        after = run_em(evidence, hypothesis, em_round)
        change = float(np.abs(after.state.angle - hypothesis.state.angle).max())
        if change > tuned.creep * factor:
            further = extrapolate(hypothesis, after, tuned.leap)
            further = run_em(evidence, further, em_round)
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


def refine_sharply(evidence: RgbdEvidence, best: DepthHypothesis) -> DepthHypothesis:
    """Refine with small robust scales where depth is exact: that reaches the end of flat valleys,
    and separates parts that move almost alike."""
    if evidence.surfaces.noise:
        return best
    tuned = evidence.settings.refine
    return refine_until_stable(evidence, best, tuned.sharp_rounds, tuned.sharp_scales,
                               tuned.sharp_width)


def refine_without_flow(evidence: RgbdEvidence, best: DepthHypothesis) -> DepthHypothesis:
    """Refine by depth alone where depth has noise: without texture, flow is too short."""
    if evidence.surfaces.flow is None:
        return best
    tuned = evidence.settings.refine
    return refine_until_stable(evidence.without_flow(), best, tuned.rounds, tuned.noisy_scales)


def polish(evidence: RgbdEvidence, found: list[DepthHypothesis]) -> DepthHypothesis:
    """Track the best hypotheses to the last frame, and refine the best of them."""
    settings, tuned = evidence.settings, evidence.settings.search
    found = refine_in_stages(
        found, evidence.select,
        (tuned.polished, lambda h: evidence.track(h, evidence.surfaces.frames - 1)),
        (tuned.refined, lambda h: run_em(evidence, h, [evidence.em_round()])))
    return refine_until_stable(evidence, min(found, key=lambda h: h.cost), settings.refine.rounds)


def try_other_chains(
    evidence: RgbdEvidence, coarse: RgbdEvidence, best: DepthHypothesis
) -> DepthHypothesis:
    """Replace a doubtful hypothesis by a better chain that moves the surest part alike."""
    settings, tuned = evidence.settings, evidence.settings.search
    for _ in range(tuned.jumps):
        if is_explained(evidence, best, tuned.doubtful):
            break
        other = best_other_chain(evidence, coarse, best)
        if hypothesis_cost(other, settings) >= tuned.jump_cost * hypothesis_cost(best, settings):
            break
        best = other
    return best


def best_other_chain(
    evidence: RgbdEvidence, coarse: RgbdEvidence, best: DepthHypothesis
) -> DepthHypothesis:
    """Refine other chains with the same part motion; return the best, or the present one."""
    settings, tuned = evidence.settings, evidence.settings.search
    found = [replace(best, state=state) for state in chains_from_motion(evidence, best)]
    found = refine_in_stages(
        found, partial(select_by_motion, settings=settings),
        (0, lambda h: coarse.label(h, Labeling())),
        (tuned.tried, lambda h: refine_until_stable(coarse, h, tuned.tried_rounds)),
        (tuned.tried_fully, lambda h: refine_until_stable(
            evidence, evidence.label(h, Labeling()), tuned.tried_fully_rounds)))
    most = np.inf
    if not is_unreliable(evidence, best):
        most = tuned.promising_cost * evidence.label(best, Labeling()).cost
    found = [h for h in select_by_motion(found, tuned.tried_sharply, settings) if h.cost < most]
    return best_of([best, *thread_map(partial(refine_sharply, evidence), found)], settings)


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
    penalty = settings.search.static_penalty * has_static_joint(hypothesis.state, settings)
    return hypothesis.cost * (1 + penalty)


def has_static_joint(state: Articulation, settings: RgbdSettings) -> bool:
    """Return whether a joint hardly moves."""
    return bool(is_static(state.angle, state.prismatic, settings).any())


def is_static(
    displacement: Array, prismatic: NDArray[np.bool_], settings: RgbdSettings
) -> NDArray[np.bool_]:
    """Return which joints [J] hardly move, for displacements [T J], rad or m."""
    arm = np.where(prismatic, settings.chain.slide_arm, 1.0)
    return np.asarray(np.abs(displacement).max(axis=0) / arm < settings.search.static_angle)


def is_explained(evidence: RgbdEvidence, hypothesis: DepthHypothesis, most: float) -> bool:
    """Return whether all joints move, and less than a share of the candidates is unexplained."""
    return (evidence.unexplained_share(hypothesis) < most
            and not has_static_joint(hypothesis.state, evidence.settings))


def is_unreliable(evidence: RgbdEvidence, hypothesis: DepthHypothesis) -> bool:
    """Return whether more candidates are unexplained than as a rule by the true motion."""
    return evidence.unexplained_share(hypothesis) > unreliable_share(evidence)


def poor_share(evidence: RgbdEvidence) -> float:
    """Return the unexplained share above which another strategy is tried."""
    tuned, noisy = evidence.settings.search, evidence.surfaces.noise > 0
    if evidence.priors.axis_dof:
        return tuned.poor_noisy if noisy else tuned.poor
    return tuned.poor_known_lines_noisy if noisy else tuned.poor_known_lines


def unreliable_share(evidence: RgbdEvidence) -> float:
    """Return the unexplained share above which an estimate is unreliable."""
    tuned = evidence.settings.search
    return tuned.unreliable_noisy if evidence.surfaces.noise else tuned.unreliable
