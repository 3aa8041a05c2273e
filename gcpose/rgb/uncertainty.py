"""How far off an estimate on plain video may be.

Its errors are seldom noise: parts or the foreground are wrong, or another motion explains the
images nearly as well. So the covariance of the bundle adjustment, which shows how well each joint
is seen, grows with the misfit of the patches, and the spread of the other hypotheses is added.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...robots.geometry import Array
from ..chain import Articulation
from ..estimator import align_displacements, calibrate_deviation
from .evidence import VideoHypothesis
from .settings import RgbSettings


@dataclass(frozen=True)
class Alternative:
    """A motion that was found in one of the last stages."""

    state: Articulation
    excess: float
    """Score above that of the best of its stage"""


def reported_deviation(
    best: VideoHypothesis, others: Iterable[Alternative], settings: RgbSettings
) -> Array:
    """Return standard deviations [T J] within which two thirds of the errors lie."""
    s = settings
    factor = s.sigma_factor * np.exp(s.sigma_misfit * (best.cost - s.sigma_cost))
    spread = s.sigma_spread * spread_of_motions(best.state, others, s.sigma_excess)
    return calibrate_deviation(
        best.deviation(), factor, np.hypot(s.sigma_floor, spread), s.sigma_unknown)


def spread_of_motions(best: Articulation, others: Iterable[Alternative], excess: float) -> Array:
    """Return the standard deviation [T-1 J] of other motions about the best one.

    Their weights are 1/e at an `excess` of the score.
    """
    total, square = 1.0, np.zeros_like(best.angle[1:])
    for other in others:
        weight = np.exp(-other.excess / excess)
        away = align_displacements(best, other.state) - best.angle
        total += weight
        square += weight * away[1:] ** 2
    return np.asarray(np.sqrt(square / total), np.float64)
