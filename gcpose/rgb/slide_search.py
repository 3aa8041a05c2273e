"""Search for the motion of one part that slides, without depth: steady slides are tried."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from ..estimator import refine_in_stages
from ..numerics import thread_map
from .evidence import RgbEvidence, VideoHypothesis, refine_points
from .labels import SampledPixels
from .scores import score_hypothesis, select_hypotheses


def search_slide(
    evidence: RgbEvidence, found: list[VideoHypothesis], points: SampledPixels
) -> list[VideoHypothesis]:
    """Return the motions of a slide before the last refinement, from those of the video as of any
    object.

    A plain front that comes nearer hardly changes the first images, and may seem to stand still.
    So slides with a constant pace are tried as well.
    """
    s = evidence.settings
    best = partial(select_hypotheses, settings=s, key=partial(score_hypothesis, settings=s),
                   motion=s.distinct_slide)
    steady = [end * np.linspace(0.0, 1.0, evidence.video.frames)[:, None] for end in s.slides_tried]
    others = [evidence.label(replace(h, state=replace(h.state, angle=angle)), points)
              for h in best(found, s.slides_from) for angle in steady]
    first = refine_points(evidence, points, 2, s.patch_reach_first)
    return refine_in_stages(
        thread_map(first, found + others), best,
        (s.refined_kept, refine_points(evidence, points, 3, s.patch_reach)))
