"""Search for the motion of a door without depth: other planes, turns and depths are tried."""

from __future__ import annotations

from functools import partial

from ..estimator import refine_in_stages
from ..numerics import thread_map
from .door_planes import (
    bridge_edge_on,
    edge_on_frames,
    exchange_door_turn,
    is_door,
    search_depths,
    turn_by_edges,
    vary_door_plane,
)
from .evidence import RgbEvidence, VideoHypothesis, refine_points
from .labels import SampledPixels
from .scores import score_hypothesis, select_hypotheses


def shows_door(evidence: RgbEvidence, hypothesis: VideoHypothesis) -> bool:
    """Return whether a hypothesis is a door whose depth is not measured."""
    return evidence.video.distance is None and is_door(hypothesis.state)


def search_door(
    evidence: RgbEvidence, found: list[VideoHypothesis], points: SampledPixels
) -> list[VideoHypothesis]:
    """Return the motions of a door before the last refinement, from those of the video as of any
    object: with other planes, turns and depths."""
    s = evidence.settings
    first = refine_points(evidence, points, 2, s.patch_reach_first)
    tilted = [t for h in select_hypotheses(found, s.tilted_kept, s)
              for t in vary_door_plane(h, s)]
    found = thread_map(first, found + tilted)
    for _ in range(1 if evidence.edges else s.door_rounds):
        found = search_turns_and_depths(evidence, found, points)
    found = sorted(found, key=partial(score_hypothesis, settings=s))
    most = 1 if evidence.edges else len(found)  # it takes long
    return thread_map(partial(search_edge_on, evidence, points=points), found[:most]) + found[most:]


def search_turns_and_depths(
    evidence: RgbEvidence, found: list[VideoHypothesis], points: SampledPixels
) -> list[VideoHypothesis]:
    """Return the best hypotheses of a door, after other turns of the best one and other depths of
    all were tried."""
    s = evidence.settings
    score = partial(score_hypothesis, settings=s)
    best = partial(select_hypotheses, settings=s, key=score)
    others = turn_doors_by_edges(evidence, best(found, s.turned_kept))
    if evidence.priors.axis_dof:  # another turn needs another axis
        others += exchange_door_turn(min(found, key=score), evidence.video.intrinsics, s)
    found = found + thread_map(refine_points(evidence, points, 2, s.patch_reach_first), others)
    refine = refine_points(evidence, points, 2, s.patch_reach)

    def search(h: VideoHypothesis) -> VideoHypothesis:
        return refine(search_depths(evidence.video, h, s))

    return refine_in_stages(found, best, *((kept, search) for kept in s.doors_kept))


def turn_doors_by_edges(
    evidence: RgbEvidence, found: list[VideoHypothesis]
) -> list[VideoHypothesis]:
    """Return doors with the turns that their straight edges show."""
    edges, frames = evidence.edges, evidence.video.frames
    if edges is None or not evidence.priors.axis_dof:
        return []
    turn = edges.turns(frames, evidence.settings)
    others = [turn_by_edges(h, turn, evidence.video.intrinsics, evidence.settings) for h in found]
    return [h for h in others if h is not None]


def search_edge_on(
    evidence: RgbEvidence, hypothesis: VideoHypothesis, points: SampledPixels
) -> VideoHypothesis:
    """Return a hypothesis of a door, improved where the door is seen edge-on."""
    s = evidence.settings
    frames = edge_on_frames(evidence.video, s)
    refine = refine_points(evidence, points, 2, s.patch_reach_first)
    score = partial(score_hypothesis, settings=s)
    for _ in range(s.edge_on_rounds if frames else 0):
        best = min(map(refine, bridge_edge_on(hypothesis, frames, s)), key=score)
        if score(best) >= score(hypothesis):
            break
        hypothesis = best
    return hypothesis
