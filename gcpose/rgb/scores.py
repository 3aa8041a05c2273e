"""Scores of the hypotheses of a search without depth, and the choice among them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from ..chain import Articulation
from ..estimator import label_difference, select_distinct
from .evidence import VideoHypothesis
from .settings import RgbSettings

Alternatives = list[tuple[Articulation, float]]
"""Other motions of the last stages, each with its score above the best of its stage."""


def compare_scores(found: list[VideoHypothesis], scores: Iterable[float]) -> Alternatives:
    """Return the motions of one stage with their scores above the best."""
    scores = list(scores)
    return [(h.state, score - min(scores)) for h, score in zip(found, scores, strict=True)]


def score_hypothesis(hypothesis: VideoHypothesis, settings: RgbSettings) -> float:
    """Return the score of a hypothesis, the lower the better.

    Patches count most: they are few but unbiased. Of hypotheses that explain patches and flow
    equally well, the best has its parts in order, axes near their hinges, and every joint well
    determined: a joint whose parts show nothing may turn by any angle.
    """
    s = settings
    sigma = float(np.log(np.maximum(hypothesis.deviation()[-1], s.min_sigma)).sum())
    return hypothesis.cost + hypothesis.penalty + s.score_sigma * sigma


def select_hypotheses(
    found: list[VideoHypothesis], most: int, settings: RgbSettings, *,
    motion: float | None = None, labels: float | None = None,
    key: Callable[[VideoHypothesis], float] = lambda h: h.cost,
) -> list[VideoHypothesis]:
    """Return the best few by `key` that differ in labels or in their last displacements.

    Seen from far, a part that turns looks like its mirror image in depth, which turns the other
    way. While both have turned little, their difference is small as well, so that a smaller one
    suffices for opposite displacements (`settings.distinct_opposite`). `motion` and `labels`
    override the other differences of the settings, rad or length and share.
    """
    apart = settings.distinct_motion if motion is None else motion
    share = settings.distinct_labels if labels is None else labels

    def differ(one: VideoHypothesis, two: VideoHypothesis) -> bool:
        first, second = one.state.angle[-1], two.state.angle[-1]
        least = np.where(first * second < 0, min(apart, settings.distinct_opposite), apart)
        return bool(label_difference(one, two) > share or (np.abs(first - second) > least).any())

    return select_distinct(found, most, differ, key)
