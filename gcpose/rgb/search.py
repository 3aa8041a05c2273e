"""Search without depth: many initial hypotheses, refined in stages; patches and tracks decide."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ..estimator import refine_in_stages, run_em
from ..numerics import thread_map
from .evidence import RgbEvidence, VideoAdjustment, VideoHypothesis, VideoRound
from .labels import SampledPixels
from .settings import RgbSettings
from .strategies import (
    exchange_parallel_turns,
    initialize_by_sweeps,
    select_hypotheses,
    vary_door_plane,
)
from .uncertainty import Alternative

Refine = Callable[[VideoHypothesis], VideoHypothesis]


def search_video(
    evidence: RgbEvidence
) -> tuple[VideoHypothesis, list[Alternative]] | None:
    """Return the best articulation, and the other motions of the last two stages; None where too
    few moving pixels are seen."""
    s, last = evidence.settings, evidence.video.frames - 1
    keys = tuple(range(0, last + 1, s.final_key_frame_step))
    many, dense = evidence.sample(keys, s.max_points), evidence.sample(keys, s.final_points)
    step = s.final_key_frame_step
    few = evidence.sample((last // (2 * step) * step,), s.exchange_points)  # the middle key frame
    found = [evidence.label(h, many) for h in initialize_by_sweeps(evidence)]
    if not found:
        return None

    def refine(points: SampledPixels, rounds: int, reach: float) -> Refine:
        return lambda h: evidence.refine_by_patches(h, points, rounds, reach)

    best = partial(select_hypotheses, settings=s, key=partial(score_hypothesis, settings=s))
    found += [t for h in select_hypotheses(found, s.tilted_kept, s) for t in vary_door_plane(h, s)]
    found = refine_in_stages(found, best, (0, refine(many, 2, s.patch_reach_first)),
                             (s.refined_kept, refine(many, 3, s.patch_reach)))
    others = exchange_parallel_turns(
        evidence, min(found, key=lambda h: score_hypothesis(h, s)), few, s.exchanged_kept)
    settle = VideoAdjustment(s.settle_scales, depth_sigma=s.depth_sigma_bundle)
    both: list[VideoRound] = [((), many), ((settle,), many)]
    others = [run_em(evidence, h, both) for h in others]
    found += thread_map(refine(many, 3, s.patch_reach_first), others)
    final = [evidence.label(h, dense) for h in best(found, s.final_kept, labels=1.0)]
    final = thread_map(refine(dense, 3, s.patch_reach), final)
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
