"""Frames in which one part was lost are found again.

Motions are tracked from frame to frame, and are lost where the part jumps: it moves fast, turns
back at once, or frames are missing. But what a key frame shows is seen again wherever the
displacement is nearly the same, also much later. Two frames are linked if patches of one are found
in the other, or if the straight edges of a door are tilted in both as the displacements say; they
are not if these edges say otherwise. A frame that no links connect with frame 0 is lost. In such a
frame, displacements are tried until edges or patches are found (relocalization; Williams, Klein and
Reid, Real-time SLAM relocalisation, ICCV 2007).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ...robots.geometry import Array
from .door_search import shows_door
from .evidence import RgbEvidence, VideoHypothesis, jerk_of
from .measurements import find_points_at_rest, frames_like_own, search_patches
from .settings import for_relocalization


def find_lost_frames(evidence: RgbEvidence, hypothesis: VideoHypothesis) -> NDArray[np.bool_]:
    """Return which frames [T] no links connect with frame 0."""
    state, points, s = hypothesis.state, hypothesis.points, evidence.settings
    lost = frames_without_path(evidence, hypothesis, np.ones(len(points.frame), bool))
    if not lost.any():
        return lost
    moving = ~find_points_at_rest(evidence.video, state, points, s)
    return frames_without_path(evidence, hypothesis, moving)


def find_doubtful_frames(evidence: RgbEvidence, hypothesis: VideoHypothesis) -> NDArray[np.bool_]:
    """Return which frames [T] after frame 0 are lost, or contradicted by the straight edges of a
    door."""
    doubtful = find_lost_frames(evidence, hypothesis) | judge_by_edges(evidence, hypothesis)[1]
    return doubtful & (np.arange(len(doubtful)) > 0)


def frames_without_path(
    evidence: RgbEvidence, hypothesis: VideoHypothesis, used: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return which frames [T] no links connect with frame 0, by the patches of some points [N]."""
    s, points = evidence.settings, hypothesis.points
    frames, (keys, key) = evidence.video.frames, np.unique(points.frame, return_inverse=True)
    near = frames_like_own(hypothesis.state, points, s.link_reach) & used[:, None]
    cost, seen, _ = search_patches(evidence.video, hypothesis.state, points, near, s)
    links = np.zeros((frames, frames), bool)
    for k, frame in enumerate(keys):
        mine = key == k
        number = seen[mine].sum(axis=0)
        mean = (cost[mine] * seen[mine]).sum(axis=0) / np.maximum(1, number)
        links[frame] = (number >= s.link_points) & (mean <= s.link_cost)
    explained, contrary = judge_by_edges(evidence, hypothesis)
    links &= ~(np.outer(explained, contrary) | np.outer(contrary, explained))
    links |= np.outer(explained, explained)
    _, group = connected_components(links, directed=False)
    return np.asarray(group != group[0], bool)


def judge_by_edges(
    evidence: RgbEvidence, hypothesis: VideoHypothesis
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return in which frames [T] the straight edges of a door agree with its displacements, and in
    which they contradict them; in neither where there are few."""
    s, frames = evidence.settings, evidence.video.frames
    if evidence.edges is None:
        return np.zeros(frames, bool), np.zeros(frames, bool)
    missed, number = evidence.edges.missed_by_frame(hypothesis.state.angle[:, 0], s)
    enough = number >= s.link_edges
    return enough & (missed <= s.link_misfit), enough & (missed >= s.contrary_misfit)


def relocalize(evidence: RgbEvidence, hypothesis: VideoHypothesis) -> VideoHypothesis:
    """Return a hypothesis of one part with fewer lost frames if possible. That it jumps does not
    count in its cost."""
    lost, jerk = find_lost_frames(evidence, hypothesis), jerk_of(hypothesis.state)
    hypothesis = replace(
        hypothesis, cost=hypothesis.cost - evidence.settings.score_jerk * jerk)
    s = for_relocalization(evidence.settings)
    again = RgbEvidence(
        evidence.video, evidence.priors, s, evidence.axis_by_edges, evidence.box)
    points = again.sample(
        again.final_keys, s.final_points, "edge" if shows_door(again, hypothesis) else "none")
    for _ in range(s.relocalization_rounds if lost.any() else 0):
        other = try_displacements(again, hypothesis, lost)
        if other is None:
            break
        other = again.refine_by_patches(
            again.label(other, points), points, 3, s.patch_reach_first)
        still_lost = find_lost_frames(again, other)
        if still_lost.sum() >= lost.sum():
            break
        hypothesis, lost = other, still_lost
        if not lost.any():
            break
    return hypothesis


def try_displacements(
    evidence: RgbEvidence, hypothesis: VideoHypothesis, lost: NDArray[np.bool_]
) -> VideoHypothesis | None:
    """Return a hypothesis with other displacements in lost frames [T]: those that the straight
    edges of a door show, else those at which patches of other frames are found; None without any.

    Frames of which neither tells move with those before and after.
    """
    before = hypothesis.state.angle[:, 0]
    by_patches, sure = displaced_by_patches(evidence, hypothesis, lost)
    by_edges, sure_by_edges = displaced_by_edges(evidence, before, lost)
    sure |= sure_by_edges
    if not sure.any():
        return None
    fixed = np.flatnonzero(sure | ~lost)
    shift = np.where(sure, np.where(sure_by_edges, by_edges, by_patches) - before, 0.0)
    shift = np.interp(np.arange(len(before)), fixed, shift[fixed])
    return replace(hypothesis, state=replace(
        hypothesis.state, angle=(before + shift)[:, None]))


def displaced_by_patches(
    evidence: RgbEvidence, hypothesis: VideoHypothesis, lost: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the displacements [T] of lost frames at which patches of the others are found best,
    and where these are much better than most."""
    s, state, points = evidence.settings, hypothesis.state, hypothesis.points
    before = state.angle[:, 0]
    others = ~find_points_at_rest(evidence.video, state, points, s) & ~lost[points.frame]
    tried = displacements_nearby(before[~lost], s.link_reach, s.relocalization_step)
    found = np.zeros((len(tried), len(before)))
    for k, displacement in enumerate(tried):
        other = replace(state, angle=np.where(lost, displacement, before)[:, None])
        wanted = frames_like_own(other, points, s.link_reach) & others[:, None] & lost
        _, seen, information = search_patches(evidence.video, other, points, wanted, s)
        found[k] = information.sum(axis=0) / (s.link_points + seen.sum(axis=0))
    sure = lost & (found.max(axis=0) > s.relocalization_lead * np.median(found, axis=0))
    return tried[found.argmax(axis=0)], sure


def displaced_by_edges(
    evidence: RgbEvidence, before: Array, lost: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the displacements [T] of lost frames that explain the edges of a door best, and where
    no other ones explain most of them."""
    s, edges = evidence.settings, evidence.edges
    if edges is None:
        return before, np.zeros(len(before), bool)
    tried = displacements_nearby(before[~lost], s.link_reach, s.edge_relocalization_step)
    missed, seen = zip(*[edges.missed_by_frame(np.where(lost, d, before), s) for d in tried],
                       strict=True)
    best = tried[np.argmin(missed, axis=0)]
    explained = np.array(missed) <= s.link_misfit
    apart = np.abs(tried[:, None] - best) > s.edge_relocalization_width
    alone = explained.any(axis=0) & ~(explained & apart).any(axis=0)
    return best, lost & alone & (seen[0] >= s.link_edges)


def displacements_nearby(known: Array, reach: float, step: float) -> Array:
    """Return displacements [N] from below to above the known ones."""
    return np.arange(known.min() - reach, known.max() + reach, step)
