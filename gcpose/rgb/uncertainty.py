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
from .settings import RgbSettings
from .tracker import VideoHypothesis


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
    sigma = np.sqrt(s.sigma_floor**2 + (factor * best.deviation()) ** 2 + spread**2)
    return np.concatenate([0 * sigma[:1], np.minimum(sigma, s.sigma_unknown)])


def spread_of_motions(best: Articulation, others: Iterable[Alternative], excess: float) -> Array:
    """Return the standard deviation [T-1 J] of other motions about the best one.

    Their weights are 1/e at an `excess` of the score. An axis with the opposite direction is the
    same axis.
    """
    total, square = 1.0, np.zeros_like(best.angle[1:])
    for other in others:
        weight = np.exp(-other.excess / excess)
        along = (motion_directions(best) * motion_directions(other.state)).sum(axis=1)
        away = np.where(along < 0, -1.0, 1.0) * other.state.angle - best.angle
        total += weight
        square += weight * away[1:] ** 2
    return np.asarray(np.sqrt(square / total), np.float64)


def motion_directions(state: Articulation) -> Array:
    """Return the directions [J 3] of turns and slides."""
    return np.where(state.prismatic[:, None], state.twist[:, 3:], state.twist[:, :3])
