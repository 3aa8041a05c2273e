"""Search without depth: many initial hypotheses, refined in stages; patches and tracks decide."""

from __future__ import annotations

import numpy as np

from ..chain import JointPriors
from ..images import VideoEvidence
from ..numerics import thread_map
from .bundle import BundleWeights
from .settings import RgbSettings
from .strategies import (
    exchange_parallel_turns,
    initialize_by_sweeps,
    select_hypotheses,
    vary_door_plane,
)
from .tracker import VideoHypothesis, VideoTracker
from .uncertainty import Alternative


def search_video(
    evidence: VideoEvidence, known: JointPriors, settings: RgbSettings
) -> tuple[VideoHypothesis, list[Alternative]] | None:
    """Return the best articulation, and the other motions of the last two stages; None where too
    few moving pixels are seen."""
    tracker, s = VideoTracker(evidence, known, settings), settings
    last = evidence.frames - 1
    keys = tuple(range(0, last + 1, s.final_key_frame_step))
    many, dense = tracker.sample(keys, s.max_points), tracker.sample(keys, s.final_points)
    step = s.final_key_frame_step
    few = tracker.sample((last // (2 * step) * step,), s.exchange_points)  # the middle key frame
    found = [tracker.relabel(h, many) for h in initialize_by_sweeps(tracker)]
    if not found:
        return None

    def best(found: list[VideoHypothesis], most: int, **by: float) -> list[VideoHypothesis]:
        return select_hypotheses(found, most, s, key=lambda h: score_hypothesis(h, s), **by)

    found += [t for h in select_hypotheses(found, s.tilted_kept, s) for t in vary_door_plane(h, s)]
    found = thread_map(lambda h: tracker.refine_by_patches(h, many, 2, s.patch_reach_first), found)
    found = thread_map(lambda h: tracker.refine_by_patches(h, many, 3, s.patch_reach),
                     best(found, s.refined_kept))
    others = exchange_parallel_turns(
        tracker, min(found, key=lambda h: score_hypothesis(h, s)), few, s.exchanged_kept)
    weights = BundleWeights(s.settle_scales, s.depth_sigma_bundle)
    others = [tracker.refine_by_flow(tracker.relabel(h, many), many, 1, weights) for h in others]
    found += thread_map(
        lambda h: tracker.refine_by_patches(h, many, 3, s.patch_reach_first), others)
    final = [tracker.relabel(h, dense) for h in best(found, s.final_kept, labels=1.0)]
    final = thread_map(lambda h: tracker.refine_by_patches(h, dense, 3, s.patch_reach), final)
    chosen = min(final, key=lambda h: score_hypothesis(h, s))
    return chosen, [other for stage in (found, final) for other in compare_scores(stage, s)
                    if other.state is not chosen.state]


def compare_scores(found: list[VideoHypothesis], settings: RgbSettings) -> list[Alternative]:
    """Return the motions of one stage with their scores above the best."""
    scores = [score_hypothesis(h, settings) for h in found]
    return [Alternative(h.state, score - min(scores))
            for h, score in zip(found, scores, strict=True)]


def score_hypothesis(hypothesis: VideoHypothesis, settings: RgbSettings) -> float:
    """Return the score of a hypothesis, the lower the better.

    Patches count most: they are few but unbiased. Of hypotheses that explain patches and flow
    equally well, the best has its parts in order, axes near their hinges, and every joint well
    determined: a joint whose parts show nothing may turn by any angle.
    """
    s = settings
    sigma = float(np.log(np.maximum(hypothesis.deviation()[-1], s.min_sigma)).sum())
    return hypothesis.cost + hypothesis.penalty + s.score_sigma * sigma
