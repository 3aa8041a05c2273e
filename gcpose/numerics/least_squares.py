"""Damped Gauss-Newton: build equations, solve, apply.

The equations of a step are matrix @ step = vector, with the matrix J^T W J and the vector J^T W r
of residuals r that fall by J @ step. Leading axes are independent problems.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array

_State = TypeVar("_State")
_Scale = TypeVar("_Scale")


@dataclass(frozen=True)
class Solver:
    """The rule for a step.

    Damping adds to the diagonal a share of it (Marquardt, 1963) and a constant (Levenberg, 1944).
    """

    damping: float = 0.0
    """Share of the diagonal that is added to it."""
    damping_floor: float = 0.0
    """Number that is added to the diagonal, in the unit of the matrix."""
    isotropic: bool = False
    """Whether the share is of the diagonal's mean."""
    max_step: float = np.inf
    """Largest change of an unknown, in the unit of the unknowns."""
    scaled: bool = False
    """Whether a longer step is scaled as a whole; else each unknown is clipped."""

    def step(
        self, matrix: Array, vector: Array, frozen: NDArray[np.bool_] | None = None,
        diagonal: Array | None = None,
    ) -> Array:
        """Solve matrix [... U U] @ step = vector [... U]; the step is 0 where frozen [U].

        Damping is computed from `diagonal` [... U], by default the matrix's: a Schur complement is
        damped by the diagonal before the elimination.
        """
        if frozen is not None and frozen.any():
            free = np.flatnonzero(~frozen)
            out = np.zeros(vector.shape)
            inner = None if diagonal is None else diagonal[..., free]
            out[..., free] = self.step(matrix[..., free[:, None], free], vector[..., free],
                                       diagonal=inner)
            return out
        size = np.diagonal(matrix, axis1=-2, axis2=-1) if diagonal is None else diagonal
        if self.isotropic:
            size = size.mean(axis=-1, keepdims=True)
        each = np.arange(vector.shape[-1])
        damped = matrix.copy()
        damped[..., each, each] += self.damping * size + self.damping_floor
        out = np.linalg.solve(damped, vector[..., None])[..., 0]
        if self.scaled:
            longest = np.abs(out).max(axis=-1, keepdims=True, initial=1e-12)
            return out * np.minimum(1.0, self.max_step / longest)
        return np.clip(out, -self.max_step, self.max_step)


def gauss_newton(
    state: _State,
    linearize: Callable[[_State, _Scale], tuple[Array, Array]],
    move: Callable[[_State, Array], _State],
    scales: Iterable[_Scale],
    solver: Solver,
) -> _State:
    """Minimize a sum of robust squares from a state, one iteration for each robust scale.

    `linearize` returns matrix and vector at a state, with robust weights of a scale; `move` returns
    the state after a step.
    """
    for scale in scales:
        state = move(state, solver.step(*linearize(state, scale)))
    return state
