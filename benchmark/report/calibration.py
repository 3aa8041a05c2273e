"""Whether a method knows how far off it is: its standard deviations and its `reliable` flags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..protocol import PCP_DEGREES, pcp_thresholds
from .statistics import SequenceJoint

LEVELS = (*(k / 20 for k in range(1, 20)), 0.99)
"""Shares of the errors that a calibrated method has within as many quantiles of the normal
distribution."""
_LARGE = PCP_DEGREES.index(10.0)


@dataclass(frozen=True)
class Calibration:
    """Final errors of one row against what the method says of them; None where nothing tells."""

    joints: int
    """(sequence, joint) pairs with a standard deviation."""
    inside: tuple[float, ...]
    """Share of these pairs within each of LEVELS; empty without any."""
    reliable: float | None
    """Share of the pairs with a flag that are reliable."""
    reliable_error: float | None
    """Mean error of the reliable pairs, deg or m."""
    other_error: float | None
    """Mean error of the others."""
    large: int
    """Pairs with a flag and an error of more than 10 deg or 10 cm."""
    large_told: float | None
    """Share of these that are not reliable."""

    @property
    def large_reliable(self) -> int:
        """Reliable pairs with an error of more than 10 deg or 10 cm."""
        return round(self.large * (1.0 - (self.large_told or 0.0)))


def calibrate(
    error_of: Mapping[SequenceJoint, float], scores: Mapping[str, Mapping[SequenceJoint, float]],
    unit: str,
) -> Calibration | None:
    """Compare final errors with standard deviations and flags; None if the scores have neither.

    Errors are in `unit`; `scores` are values of pairs by metric.
    """

    def errors_and(metric: str) -> Array:
        """Return the final errors and values [2 N] of the pairs that have this metric."""
        value = scores.get(metric, {})
        found = [(error, value[pair]) for pair, error in error_of.items() if pair in value]
        return np.array(found, np.float64).reshape(-1, 2).T

    (error, sigma), (flagged, flag) = errors_and("sigma"), errors_and("reliable")
    if not (error.size or flag.size):
        return None
    quantile = [NormalDist().inv_cdf((1 + level) / 2) for level in LEVELS]
    reliable, large = flag > 0.5, flagged > pcp_thresholds(unit)[_LARGE]
    return Calibration(
        joints=len(error),
        inside=tuple(float(np.mean(error <= z * sigma)) for z in quantile) if error.size else (),
        reliable=_mean(reliable),
        reliable_error=_mean(flagged[reliable]),
        other_error=_mean(flagged[~reliable]),
        large=int(large.sum()),
        large_told=_mean(~reliable[large]),
    )


def _mean(values: Array | NDArray[np.bool_]) -> float | None:
    return float(values.mean()) if values.size else None
