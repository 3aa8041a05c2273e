"""EM over a video (Sec. 3.2 to 3.4): labels follow the motion, and bundle adjustment the labels.

What differs between depth (`gcpose.rgbd`) and plain video (`gcpose.rgb`) is the evidence: how
points are measured and labelled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from ...robots.geometry import Array
from ..chain import (
    Articulation,
    ChainSettings,
    HingePrior,
    JointPriors,
    axis_bases,
    extrapolate_to,
    prior_equations,
    take_step,
)
from ..numerics import Solver, thread_map
from .hypothesis import BundleEquations, Hypothesis, LabeledPoints

_MIN_STEP = 1e-6  # rad or length; below this, iterations end


@dataclass(frozen=True)
class Adjustment:
    """How a bundle adjustment is made; evidence may add how it measures."""

    scales: tuple[float, ...]
    """Robust scale of each iteration"""
    fixed_axes: bool = False
    """Whether only displacements are adjusted"""
    newest: bool = False
    """Whether only those of the last frame are"""
    prior: float = 1.0
    """Weight of the priors on motion and axes"""


_P = TypeVar("_P", bound=LabeledPoints)
_A = TypeVar("_A", bound=Adjustment)
_L = TypeVar("_L")
_P_co = TypeVar("_P_co", bound=LabeledPoints, covariant=True)
_A_contra = TypeVar("_A_contra", bound=Adjustment, contravariant=True)
_L_contra = TypeVar("_L_contra", contravariant=True)

Round = tuple[tuple[_A, ...], _L]
"""A round of EM: adjustments (M-steps), then how points are labelled (E-step)."""


class Residuals(Protocol[_P_co]):
    """Labelled points with their measurements in all frames, which an adjustment explains."""

    @property
    def points(self) -> _P_co:
        """The points, with what was last estimated of each."""
        ...

    def linearize(
        self, state: Articulation, basis: tuple[Array, ...], scale: float,
        prior: tuple[Array, Array],
    ) -> tuple[BundleEquations, Callable[[Array], Residuals[_P_co]]]:
        """Return the equations at a state with robust weights of a scale, and the residuals after
        a step. The prior's matrix and vector are added before other unknowns are eliminated."""
        ...


class Evidence(Protocol[_P, _A_contra, _L_contra]):
    """A video, and how its points are measured and labelled."""

    priors: JointPriors
    solver: Solver
    chain: ChainSettings

    def hinges(self, hypothesis: Hypothesis[_P]) -> HingePrior:
        """Return where the parts of a hypothesis meet."""
        ...

    def measure(self, hypothesis: Hypothesis[_P], how: _A_contra) -> Residuals[_P]:
        """Measure the points of a hypothesis where it expects them."""
        ...

    def label(self, hypothesis: Hypothesis[_P], where: _L_contra, /) -> Hypothesis[_P]:
        """Label points by the motion of a hypothesis, and find its cost (E-step)."""
        ...


def adjust(evidence: Evidence[_P, _A, _L], hypothesis: Hypothesis[_P], how: _A) -> Hypothesis[_P]:
    """Adjust displacements, axes and points of a hypothesis to what is measured of the points, by
    damped Gauss-Newton (M-step)."""
    state, equations = hypothesis.state, hypothesis.equations
    residuals, hinges = evidence.measure(hypothesis, how), evidence.hinges(hypothesis)
    axis_dof = 0 if how.newest or how.fixed_axes else evidence.priors.axis_dof
    for scale in how.scales:
        basis = axis_bases(state, hinges.near, axis_dof)
        matrix, vector = prior_equations(state, basis, hinges, evidence.chain)
        equations, after = residuals.linearize(
            state, basis, scale, (how.prior * matrix, how.prior * vector))
        frozen = how.newest & (np.arange(len(vector)) < state.angle[1:-1].size)
        step = evidence.solver.step(equations.matrix, equations.vector, frozen, equations.diagonal)
        state, residuals = take_step(state, basis, step), after(step)
        if np.abs(step).max() < _MIN_STEP:
            break
    return replace(hypothesis, state=state, points=residuals.points, equations=equations)


def run_em(
    evidence: Evidence[_P, _A, _L], hypothesis: Hypothesis[_P], rounds: Iterable[Round[_A, _L]]
) -> Hypothesis[_P]:
    """Run rounds of EM on the frames of a hypothesis."""
    for adjustments, labels in rounds:
        for how in adjustments:
            hypothesis = adjust(evidence, hypothesis, how)
        hypothesis = evidence.label(hypothesis, labels)
    return hypothesis


def track(
    evidence: Evidence[_P, _A, _L], hypothesis: Hypothesis[_P], until: int,
    rounds_of: Callable[[Hypothesis[_P]], Iterable[Round[_A, _L]]], steps: int = 1,
) -> Hypothesis[_P]:
    """Extend a hypothesis frame by frame to frame `until`: extrapolate its last `steps` steps, and
    run the rounds of EM that the extended hypothesis asks for."""
    for last in range(len(hypothesis.state.angle), until + 1):
        state = extrapolate_to(hypothesis.state, last, steps)
        hypothesis = replace(hypothesis, state=state)
        hypothesis = run_em(evidence, hypothesis, rounds_of(hypothesis))
    return hypothesis


def refine_in_stages(
    found: list[Hypothesis[_P]],
    select: Callable[[list[Hypothesis[_P]], int], list[Hypothesis[_P]]],
    *stages: tuple[int, Callable[[Hypothesis[_P]], Hypothesis[_P]]],
) -> list[Hypothesis[_P]]:
    """Take hypotheses through stages, each of so many selected ones (0: all) and how each of these
    is refined."""
    for most, refine in stages:
        found = thread_map(refine, select(found, most) if most else found)
    return found
