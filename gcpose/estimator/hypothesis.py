"""A hypothesis about the object, how sure it is, and the choice of some that differ."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import Articulation


class LabeledPoints(Protocol):
    """Points of key frames with the parts that they are on."""

    @property
    def label(self) -> NDArray[np.int64]:
        """[N] parts by which hypotheses are compared."""
        ...


_P = TypeVar("_P", bound=LabeledPoints)


@dataclass(frozen=True)
class BundleEquations:
    """Normal equations of U unknowns: displacements of frames 1.. (rad or m), then of the axes.

    All other unknowns are eliminated. Residuals are in standard deviations, so that the inverse
    matrix is a covariance.
    """

    matrix: Array
    """[U U]"""
    vector: Array
    """[U]"""
    scatter: Array | None = None
    """[U U] covariance of `vector`, if the errors of a part in a frame are the same; None: each
    residual has an error of its own, and it is `matrix`."""
    diagonal: Array | None = None
    """[U] of the matrix before other unknowns are eliminated, if it differs"""


@dataclass(frozen=True)
class Hypothesis(Generic[_P]):
    """An articulation, its labelled points, and their cost."""

    state: Articulation
    points: _P
    base: Array
    """[3] where the chain begins; at depth 1 where depth is not measured"""
    cost: float
    """Rank among hypotheses of the same stage"""
    equations: BundleEquations | None = None
    """Of the last adjustment"""
    penalty: float = 0.0
    """What speaks against it besides the cost, in the unit of the cost"""

    def deviation(self) -> Array:
        """Return the standard deviations [T-1 J] of the displacements by the residuals, rad or m.

        With scatter S the covariance is the sandwich H^-1 S H^-1, which holds where residuals are
        correlated within clusters (Huber, The behavior of maximum likelihood estimates under
        nonstandard conditions, 1967; Liang and Zeger, 1986).
        """
        equations, held = self.equations, self.state.angle[1:]
        assert equations is not None
        covariance = np.linalg.inv(equations.matrix + 1e-6 * np.eye(len(equations.matrix)))
        if equations.scatter is not None:
            covariance = covariance @ equations.scatter @ covariance
        return np.sqrt(np.maximum(np.diag(covariance)[: held.size], 0.0)).reshape(held.shape)


def calibrate_deviation(formal: Array, factor: float, floor: Array | float, most: float) -> Array:
    """Return standard deviations [T J] that two thirds of the errors lie within, for formal ones
    [T-1 J] of frames 1...

    Errors that points share (labels, foreground, smoothing) exceed what residuals show: factor,
    floor (scalar or [T-1 J]) and the largest deviation `most` are from training sequences.
    """
    sigma = np.minimum(np.hypot(factor * formal, floor), most)
    return np.concatenate([0 * sigma[:1], sigma])


def spread_of_motions(
    best: Articulation, others: Iterable[tuple[Articulation, float]], excess: float
) -> Array:
    """Return the standard deviation [T-1 J] of other motions about the best one.

    Each comes with its score above the best of its stage: its weight is 1/e at an `excess`.
    """
    total, square = 1.0, np.zeros_like(best.angle[1:])
    for other, above in others:
        weight = np.exp(-above / excess)
        away = align_displacements(best, other) - best.angle
        total += weight
        square += weight * away[1:] ** 2
    return np.asarray(np.sqrt(square / total), np.float64)


def label_difference(one: Hypothesis[_P], two: Hypothesis[_P]) -> float:
    """Return the share of the points that two hypotheses label otherwise."""
    return float(np.mean(one.points.label != two.points.label))


def align_displacements(state: Articulation, other: Articulation) -> Array:
    """Return the displacements [T J] of another articulation in the directions of this one's axes:
    an axis with the opposite direction is the same axis."""
    along = (state.directions * other.directions).sum(axis=1)
    return np.where(along < 0, -1.0, 1.0) * other.angle


def select_distinct(
    found: list[Hypothesis[_P]], most: int,
    differ: Callable[[Hypothesis[_P], Hypothesis[_P]], bool],
    key: Callable[[Hypothesis[_P]], float] = lambda h: h.cost,
) -> list[Hypothesis[_P]]:
    """Return the `most` best by `key` of which any two differ."""
    out: list[Hypothesis[_P]] = []
    for h in sorted(found, key=key):
        if all(differ(h, other) for other in out):
            out.append(h)
        if len(out) == most:
            break
    return out
