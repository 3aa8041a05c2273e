"""Search without depth: many initial hypotheses, refined in stages; patches and tracks decide."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import extrapolate_to, merge_beams, scale_axes, select_by_steps, spread_places
from ..estimator import refine_in_stages, run_em
from ..images import geodesic_rank
from ..numerics import thread_map
from .door_search import search_door, shows_door
from .evidence import (
    PACE_STEPS,
    RgbEvidence,
    VideoAdjustment,
    VideoHypothesis,
    places_at_start,
    refine_points,
)
from .flow_sweep import sweep_flow
from .labels import SampledPixels
from .outline import OutlineKind
from .parallel_axes import candidate_feet, keep_total_turn, parallel_joints, redistribute
from .points import InverseDepthPoints
from .relocalization import find_doubtful_frames, relocalize
from .scores import Alternatives, compare_scores, score_hypothesis, select_hypotheses
from .settings import RgbSettings, for_last_refinement
from .slide_search import search_slide


@dataclass(frozen=True)
class SearchResult:
    """The best articulation that was found, and what tells how certain it is."""

    best: VideoHypothesis
    others: Alternatives
    """The other motions of the last two stages"""
    alone: bool = False
    """Whether there were several searches, and no other one has found this motion"""


def search_video(evidence: RgbEvidence) -> SearchResult | None:
    """Return the best articulation; None where too few moving pixels are seen.

    Each flow of the video has its search. Their best motions are compared by the first flow. A
    motion that several searches have found counts as better.
    """
    s = evidence.settings
    score = partial(score_hypothesis, settings=s)
    searches = [search_motions(each) for each in evidence.by_each_flow()]
    best = [select_hypotheses(found, s.final_kept, s, labels=1.0, key=score) for found in searches]
    if not any(best):
        return None
    last = refine_last(evidence, [h for some in best for h in some])
    search = np.repeat(np.arange(len(best)), [len(some) for some in best])
    first, scores, agreed = choose_motion(last, search, s)
    if evidence.joints == 1 and find_doubtful_frames(evidence, last[first]).any():
        last, searches = thread_map(partial(relocalize, evidence), last), []  # others are lost too
        first, scores, agreed = choose_motion(last, search, s)
    others = [other for found in searches for other in compare_scores(found, map(score, found))]
    others += compare_scores(last, scores)
    others = [other for other in others if other[0] is not last[first].state]
    return SearchResult(last[first], others, len(best) > 1 and not agreed)


def choose_motion(
    last: list[VideoHypothesis], search: NDArray[np.int64], settings: RgbSettings
) -> tuple[int, list[float], bool]:
    """Return the index of the best of N motions, the scores of all, and whether another search has
    found it as well; `search` [N] tells which search found each."""
    s = settings
    agreeing = count_agreeing(np.stack([h.state.angle[-1] for h in last]), search, s.agreement)
    scores = [score_hypothesis(h, s) - s.score_agreement * n
              for h, n in zip(last, agreeing, strict=True)]
    first = int(np.argmin(scores))
    return first, scores, bool(agreeing[first] > 0)


def count_agreeing(
    motion: Array, search: NDArray[np.int64], tolerance: float
) -> NDArray[np.int64]:
    """Return for each of N motions [N J] how many other searches have one that differs by at most
    a tolerance in each joint; `search` [N] tells which search found it."""
    alike = np.abs(motion[:, None] - motion).max(axis=2) <= tolerance
    return np.array([len(np.unique(search[same & (search != own)]))
                     for same, own in zip(alike, search, strict=True)])


def search_motions(evidence: RgbEvidence) -> list[VideoHypothesis]:
    """Return the motions of the stage before the last; none where too few moving pixels are
    seen."""
    s, last = evidence.settings, evidence.video.frames - 1
    keys = evidence.final_keys
    many = evidence.sample(keys, s.max_points)
    step = s.final_key_frame_step
    few = evidence.sample((last // (2 * step) * step,), s.exchange_points)  # the middle key frame
    found = thread_map(partial(evidence.label, points=many), initialize_by_sweeps(evidence))
    if not found:
        return []
    score = partial(score_hypothesis, settings=s)
    best = partial(select_hypotheses, settings=s, key=score)
    refine = partial(refine_points, evidence)
    if shows_door(evidence, found[0]):
        return search_door(evidence, found, many)
    if evidence.may_be_slide:
        return search_slide(evidence, found, many)
    found = thread_map(refine(many, 2, s.patch_reach_first), found)
    found = refine_in_stages(found, best, (s.refined_kept, refine(many, 3, s.patch_reach)))
    several = len(parallel_joints(min(found, key=score).state, s)) > 1
    others = [other for h in best(found, s.exchanged_from if several else 1, labels=1.0)
              for other in exchange_parallel_turns(evidence, h, few, s.exchanged_kept)]
    settle = VideoAdjustment(s.settle_scales, depth_sigma=s.depth_sigma_bundle)
    again = refine(many, 3, s.patch_reach_first)
    return found + thread_map(
        lambda h: again(run_em(evidence, h, [((), many), ((settle,), many)])), others)


def refine_last(evidence: RgbEvidence, found: list[VideoHypothesis]) -> list[VideoHypothesis]:
    """Return hypotheses that are refined by more points, and by points on the outline.

    Those of several joints whose axes have known directions and whose depth is not measured take
    more steps (see `for_last_refinement`), and the best of them more rounds.
    """
    s, several = evidence.settings, evidence.joints > 1
    outline: OutlineKind = (
        "round" if several else "edge" if shows_door(evidence, found[0]) else "none")
    converge = (several and evidence.priors.direction is not None
                and evidence.video.distance is None)
    if converge:
        evidence = RgbEvidence(evidence.video, evidence.priors, for_last_refinement(s))
    dense = evidence.sample(evidence.final_keys, s.final_points, outline)
    refine = refine_points(evidence, dense, 3, s.patch_reach)
    found = thread_map(lambda h: refine(evidence.label(h, dense)), found)
    if converge:
        best = np.argsort([score_hypothesis(h, s) for h in found])[: s.continued_kept]
        for i, h in zip(best, thread_map(refine, [found[i] for i in best]), strict=True):
            found[i] = h
    return found


def initialize_by_sweeps(evidence: RgbEvidence) -> list[VideoHypothesis]:
    """Return hypotheses from sweeps over the first frames, tracked through the video."""
    s, last = evidence.settings, evidence.video.frames - 1
    points = evidence.sample((0,), s.sweep_points)
    if len(points.frame) < s.min_points:
        return []
    spans = sorted({min(span, last) for span in s.sweep_spans})
    found = [h for some in thread_map(lambda span: sweep_hypotheses(evidence, points, span), spans)
             for h in some]
    start, first = min(max(spans) + 1, last), [evidence.tracking_round(points)]

    def begin(swept: VideoHypothesis) -> VideoHypothesis:
        state = extrapolate_to(swept.state, start, PACE_STEPS)
        return run_em(evidence, replace(swept, state=state), first)

    return refine_in_stages(
        found, partial(select_hypotheses, settings=s, motion=s.distinct_motion_first),
        (s.first_kept, begin),
        (s.half_kept, lambda h: evidence.track(h, min(s.half_frame, last))),
        (s.tracked_kept, lambda h: evidence.track(h, last)))


def sweep_hypotheses(
    evidence: RgbEvidence, points: SampledPixels, to: int
) -> list[VideoHypothesis]:
    """Return the best chains over frames 0 and `to`, labeled from each candidate of the base."""
    known, settings = evidence.priors, evidence.settings
    most = settings.sweep_kept
    scales = settings.sweep_scales if evidence.unit_is_free else (1.0,)
    found = [sweep_flow(evidence.video, scale_axes(known, scale), points, to, settings)
             for scale in scales]
    beam = select_by_steps(merge_beams(found), most)
    start, bases = start_points(points), base_candidates(evidence, points, 0)
    return [evidence.label(VideoHypothesis(state, start, base, np.inf), points)
            for state in beam.articulations(known, to, most) for base in bases]


def start_points(pixels: SampledPixels) -> InverseDepthPoints:
    """Return points of part 1 at their expected depths."""
    one = np.ones(len(pixels.frame), np.int64)
    return InverseDepthPoints.without_measurements(pixels.frame, pixels.ray, one, pixels.expected)


def base_candidates(evidence: RgbEvidence, points: SampledPixels, key: int) -> list[Array]:
    """Return points [3] where the chain may begin in a key frame, the slower first; at depth 1 if
    it is not known."""
    if evidence.priors.base is not None:
        return [evidence.priors.base]
    s, (u, v) = evidence.settings, points.pixel.T
    around = slice(max(0, key - s.base_frames), key + s.base_frames + 1)
    speed = np.linalg.norm(evidence.video.flow[around, v, u], axis=2).mean(axis=0)
    slow = points.average(speed[:, None])[:, 0]
    start = points.ray[slow <= np.quantile(slow, s.base_slow_share)]
    out: list[Array] = []
    for _ in range(2):
        rank = geodesic_rank(points.ray, start, evidence.video.settings)
        out.append(points.ray[rank <= s.base_end_share].mean(axis=0))
        start = points.ray[rank >= 1 - s.base_end_share]
    return out


def exchange_parallel_turns(
    evidence: RgbEvidence, hypothesis: VideoHypothesis, points: SampledPixels, most: int
) -> list[VideoHypothesis]:
    """Return the best solutions that distribute turns otherwise among parallel neighbors."""
    state, settings = hypothesis.state, evidence.settings
    if not (len(points.frame) and (hypothesis.points.frame == points.frame[0]).any()):
        return []
    at = places_at_start(hypothesis, int(points.frame[0]))
    found: list[VideoHypothesis] = []
    for j in parallel_joints(state, settings):
        places = at[:0]
        if evidence.priors.axis_dof:  # else the axes stay where they are known to be
            places = spread_places(at, settings.exchange_places, settings.spread_points)
        feet = np.stack([np.cross(state.twist[j, :3], state.twist[j, 3:]), *places])
        others = [
            keep_total_turn(state, j, hinge, foot, settings)
            for hinge in places
            for foot in candidate_feet(state, j, hinge, feet, settings.exchange_feet)
        ]
        others += [redistribute(state, j, share) for share in settings.exchange_shares]
        found += thread_map(
            lambda other: evidence.label(replace(hypothesis, state=other), points),
            [other for other in others if other is not None])
    how = VideoAdjustment(settings.exchange_scales, depth_sigma=settings.depth_sigma_exchange)
    found = thread_map(lambda h: run_em(evidence, h, [((how,), points)] * 2),
                       select_hypotheses(found, 4 * most, settings))
    return select_hypotheses(found, most, settings)
