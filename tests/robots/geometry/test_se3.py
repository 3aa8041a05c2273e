"""Laws of SE(3): exp and log undo each other, the adjoint moves twists, small turns are exact."""

from __future__ import annotations

import numpy as np
from gcbench.robots.geometry import apply, inverse, se3
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm

VECTORS = arrays(np.float64, 3, elements=st.floats(-10, 10, allow_subnormal=False))
SIZES = st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 0.99e-4, 1.01e-4, 1e-2, 1.0, 3.0])


def unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v)
    return v / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])


@st.composite
def twists(draw: st.DrawFn) -> np.ndarray:
    """Turns from nothing to nearly a half turn, also where the series take over."""
    return np.concatenate([unit(draw(VECTORS)) * draw(SIZES), draw(VECTORS)])


def algebra(twist: np.ndarray) -> np.ndarray:
    out = np.zeros((4, 4))
    out[:3, :3], out[:3, 3] = se3.hat(twist[:3]), twist[3:]
    return out


@given(VECTORS, VECTORS)
def test_hat_is_the_cross_product(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(se3.hat(a) @ b, np.cross(a, b), atol=1e-12)


@given(twists())
def test_exp_is_the_matrix_exponential(twist: np.ndarray) -> None:
    np.testing.assert_allclose(se3.exp(twist), expm(algebra(twist)), atol=1e-12)


@given(twists())
def test_log_undoes_exp(twist: np.ndarray) -> None:
    np.testing.assert_allclose(se3.log(se3.exp(twist)), twist, atol=2e-11)


@given(twists(), twists())
def test_the_adjoint_moves_twists(twist: np.ndarray, frame: np.ndarray) -> None:
    motion = se3.exp(frame)
    moved = se3.exp(se3.adjoint(motion) @ twist)
    np.testing.assert_allclose(moved, motion @ se3.exp(twist) @ inverse(motion), atol=1e-9)


@given(twists(), VECTORS, st.floats(-3, 3))
def test_a_screw_turns_about_its_line(twist: np.ndarray, point: np.ndarray, angle: float) -> None:
    direction = unit(twist[3:])
    screw = np.concatenate([direction, np.cross(point, direction)])
    motion = se3.revolute_motion(screw, angle)
    np.testing.assert_allclose(motion, se3.exp(screw * angle), atol=1e-10)
    np.testing.assert_allclose(apply(motion, point[None])[0], point, atol=1e-10)


@given(st.lists(twists(), min_size=1, max_size=4))
def test_leading_axes_are_independent(each: list[np.ndarray]) -> None:
    together = se3.exp(np.stack(each))
    for one, twist in zip(together, each, strict=True):
        np.testing.assert_array_equal(one, se3.exp(twist))
