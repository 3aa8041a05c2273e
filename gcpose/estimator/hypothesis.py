"""A hypothesis about the object, and the choice of some that differ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import Articulation
from .equations import BundleEquations


class LabeledPoints(Protocol):
    """Points of key frames with the parts that they are on."""

    @property
    def label(self) -> NDArray[np.int64]:
        """[N] parts by which hypotheses are compared."""
        ...


P = TypeVar("P", bound=LabeledPoints)


@dataclass(frozen=True)
class Hypothesis(Generic[P]):
    """An articulation, its labelled points, and their cost."""

    state: Articulation
    points: P
    base: Array
    """[3] where the chain begins; at depth 1 where depth is not measured"""
    cost: float
    """Rank among hypotheses of the same stage"""
    equations: BundleEquations | None = None
    """Of the last adjustment"""
    penalty: float = 0.0
    """What speaks against it besides the cost, in the unit of the cost"""

    def deviation(self) -> Array:
        """Return the standard deviations [T-1 J] of the displacements, from the residuals."""
        assert self.equations is not None
        return self.equations.deviation(*self.state.angle.shape)


def label_difference(one: Hypothesis[P], two: Hypothesis[P]) -> float:
    """Return the share of the points that two hypotheses label otherwise."""
    return float(np.mean(one.points.label != two.points.label))


def align_displacements(state: Articulation, other: Articulation) -> Array:
    """Return the displacements [T J] of another articulation in the directions of this one's axes:
    an axis with the opposite direction is the same axis."""
    along = (state.directions * other.directions).sum(axis=1)
    return np.where(along < 0, -1.0, 1.0) * other.angle


def select_distinct(
    found: list[Hypothesis[P]], most: int, differ: Callable[[Hypothesis[P], Hypothesis[P]], bool],
    key: Callable[[Hypothesis[P]], float] = lambda h: h.cost,
) -> list[Hypothesis[P]]:
    """Return the `most` best by `key` of which any two differ."""
    out: list[Hypothesis[P]] = []
    for h in sorted(found, key=key):
        if all(differ(h, other) for other in out):
            out.append(h)
        if len(out) == most:
            break
    return out
