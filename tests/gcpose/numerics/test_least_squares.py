"""Laws of damped Gauss-Newton steps and of robust weights."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from gcbench.gcpose.numerics import (
    Solver,
    cauchy_weight,
    gauss_newton,
    geman_mcclure_cost,
    truncated_cost,
)
from hypothesis import given
from hypothesis import strategies as st

SEEDS = st.integers(0, 2**32 - 1)
KERNELS = {
    "Geman-McClure": (geman_mcclure_cost, lambda s: 1 / (1 + s) ** 2),  # as the kernels have it
    "Cauchy": (np.log1p, cauchy_weight),
    "truncated": (lambda s: truncated_cost(s, 1.0), lambda s: (s < 1.0) * 1.0),
}


def problem(seed: int, size: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(3, 2 * size, size))
    return rows.swapaxes(1, 2) @ rows, rng.normal(size=(3, size))


@given(SEEDS)
def test_an_undamped_step_solves_the_equations(seed: int) -> None:
    matrix, vector = problem(seed)
    step = Solver().step(matrix, vector)
    assert np.allclose((matrix @ step[..., None])[..., 0], vector, atol=1e-6)


@given(SEEDS, st.lists(st.booleans(), min_size=5, max_size=5))
def test_frozen_unknowns_stay_and_the_others_are_solved_alone(seed: int, held: list[bool]) -> None:
    matrix, vector = problem(seed)
    frozen, solver = np.array(held), Solver(damping=0.1, damping_floor=0.01, max_step=0.3)
    step = solver.step(matrix, vector, frozen)
    assert not step[:, frozen].any()
    heavy = matrix + 1e12 * np.diag(frozen)  # what a mask stands for
    assert np.allclose(step, solver.step(heavy, vector, diagonal=np.diagonal(matrix, 0, 1, 2)),
                       atol=1e-6)


@given(SEEDS, st.floats(1e-3, 10.0))
def test_no_step_is_longer_than_allowed(seed: int, most: float) -> None:
    matrix, vector = problem(seed)
    full = Solver().step(matrix, vector)
    assert np.allclose(Solver(max_step=most).step(matrix, vector), np.clip(full, -most, most))
    scaled = Solver(max_step=most, scaled=True).step(matrix, vector)
    assert np.abs(scaled).max() <= most * (1 + 1e-9)
    cosine = (scaled * full).sum(axis=1) / np.linalg.norm(scaled, axis=1) / np.linalg.norm(
        full, axis=1)
    assert np.allclose(cosine, 1.0)  # the direction stays


@given(SEEDS, st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_damping_shortens_steps(seed: int, damping: float, more: float) -> None:
    matrix, vector = problem(seed)

    def decrease(share: float) -> np.ndarray:
        step = Solver(damping=share, isotropic=True).step(matrix, vector)
        return np.linalg.norm(step, axis=1)

    assert (decrease(damping + more) <= decrease(damping) * (1 + 1e-9)).all()


@given(SEEDS)
def test_gauss_newton_finds_the_minimum_of_a_line_with_outliers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, true = rng.uniform(-1, 1, 60), rng.normal(size=2)
    y = true[0] + true[1] * x
    y[:12] += 30.0

    def linearize(line: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
        rows = np.stack([np.ones_like(x), x], axis=1)
        residual = y - rows @ line
        weight = cauchy_weight((residual / scale) ** 2)[:, None]
        return (weight * rows).T @ rows, (weight * rows).T @ residual

    found = gauss_newton(np.zeros(2), linearize, lambda a, b: a + b,
                         (20.0, 10.0, 5.0, 2.0, 1.0, 0.3, 0.1, 0.1), Solver())
    assert np.abs(found - true).max() < 1e-2


@pytest.mark.parametrize(("cost", "weight"), KERNELS.values(), ids=KERNELS)
@given(square=st.floats(0.0, 100.0).filter(lambda s: abs(s - 1) > 1e-3))
def test_the_weight_is_the_derivative_of_the_cost(
    cost: Callable[[np.ndarray], np.ndarray], weight: Callable[[np.ndarray], np.ndarray],
    square: float,
) -> None:
    step = 1e-5
    ends = cost(np.array([square + step, max(0.0, square - step)]))
    slope = (ends[0] - ends[1]) / (square + step - max(0.0, square - step))
    assert slope == pytest.approx(weight(np.array([square]))[0], abs=1e-4)


@pytest.mark.parametrize("cost", [c for c, _ in KERNELS.values()], ids=KERNELS)
def test_costs_are_squares_near_zero_and_grow(cost: Callable[[np.ndarray], np.ndarray]) -> None:
    square = np.geomspace(1e-6, 1e3, 100)
    assert cost(square[:1])[0] == pytest.approx(square[0], rel=1e-5)
    assert (np.diff(cost(square)) >= 0).all() and (cost(square) <= square).all()
