"""GC-Pose on images with noisy depth: each kind of evidence is searched, then both are adjusted to.

Depth and images fail on different videos. Their motions are starts for one bundle adjustment to
both (Sec. 3.4), and the motion that both explain best is the estimate.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from ...renderer.types import Estimate
from ...robots.geometry import Array
from ..chain import Articulation, JointPriors, screws_of
from ..estimator import align_displacements, calibrate_deviation, run_em, spread_of_motions
from ..images import Flow
from ..numerics import thread_map
from ..rgb import RgbEvidence, search_video
from ..rgbd import (
    DepthHypothesis,
    DepthVideo,
    RgbdSettings,
    estimate_rgbd,
    is_unreliable,
    label_frames,
    search_depth,
)
from .evidence import FusedEvidence, FusedHypothesis, in_unit
from .settings import FusionSettings


def estimate_by_fusion(
    video: DepthVideo, seen: RgbEvidence, priors: JointPriors, flow: Flow,
    settings: FusionSettings, of_depth: RgbdSettings,
) -> Estimate:
    """Estimate the motion of one sequence with noisy depth, by depth and images at once (Sec. 3.2
    to 3.4); by depth alone where the images show too little.

    `seen` is what the images show, with the measured depth as a prior. The flow is for starts by
    depth.
    """
    unit, by_images = seen.video.distance, motions_by_images(seen, settings)
    if unit is None or not by_images:
        return estimate_rgbd(video, priors, flow, of_depth)
    depth, _, final = search_depth(video, priors, flow, of_depth)
    evidence = FusedEvidence(depth.without_flow(), seen, unit, settings)
    starts = [final.state, *(in_unit(state, 1 / unit) for state in by_images)]
    found = thread_map(partial(refine_from, evidence, final), starts)
    found.sort(key=lambda h: h.cost)
    state = found[0].state
    unreliable = is_unreliable(evidence.depth, evidence.by_depth(found[0]))
    least = of_depth.sigma_unreliable if unreliable else 0.0
    return Estimate(state.angle, screws_of(state.twist, state.prismatic),
                    label_frames(depth, state), deviation_by_fusion(found, settings, least))


def motions_by_images(seen: RgbEvidence, settings: FusionSettings) -> list[Articulation]:
    """Return the best motions by the images that differ, in their unit of length."""
    result = search_video(seen)
    if result is None:
        return []
    others = sorted(result.others, key=lambda other: other[1])
    kept: list[Articulation] = []
    for state in (result.best.state, *(state for state, _ in others)):
        apart = [np.abs(align_displacements(state, k)[-1] - state.angle[-1]).max() for k in kept]
        if len(kept) < settings.image_starts and min(apart, default=np.inf) > (
                seen.settings.distinct_motion):
            kept.append(state)
    return kept


def refine_from(
    evidence: FusedEvidence, like: DepthHypothesis, state: Articulation
) -> FusedHypothesis:
    """Return a motion in metres after EM on depth and images; its cost is the score by both."""
    images, s = evidence.images, evidence.settings
    pixels = images.sample(images.final_keys, images.settings.max_points)
    span = images.settings.patch_span
    rounds = images.adjustments_by_patches(s.rounds, images.settings.patch_reach_first, span)
    found = run_em(evidence, evidence.begin(state, like, pixels),
                   [((how,), pixels) for how in rounds])
    rated = images.with_misfit(evidence.by_images(found), span)
    return replace(found, cost=rated.cost + rated.penalty + s.score_depth * found.cost)


def deviation_by_fusion(
    found: list[FusedHypothesis], settings: FusionSettings, least: float = 0.0
) -> Array:
    """Return standard deviations [T J] within which two thirds of the errors lie, of the first of
    the hypotheses, which are sorted by their scores; at least `least` rad or m.

    That of other motions about it is added, each weighted by its score.
    """
    s, best = settings, found[0]
    others = [(h.state, h.cost - best.cost) for h in found[1:]]
    spread = s.spread * spread_of_motions(best.state, others, s.excess)
    return calibrate_deviation(
        best.deviation(), s.factor, np.hypot(max(s.floor, least), spread), s.sigma_unknown)
