"""Laws of the pinhole: projection and its inverse undo each other, taps interpolate planes."""

from __future__ import annotations

import numpy as np
from gcbench.robots.geometry import pinhole
from hypothesis import given
from hypothesis import strategies as st

POSITIVE = st.floats(50, 2000)


@st.composite
def cameras(draw: st.DrawFn) -> np.ndarray:
    fx, fy, skew = draw(POSITIVE), draw(POSITIVE), draw(st.floats(-5, 5))
    return np.array([[fx, skew, draw(POSITIVE)], [0, fy, draw(POSITIVE)], [0, 0, 1.0]])


@given(cameras(), st.floats(-500, 3000), st.floats(-500, 3000), st.floats(0.01, 100))
def test_project_undoes_unproject(k: np.ndarray, u: float, v: float, z: float) -> None:
    point = pinhole.unproject(k, [u, v], z)
    np.testing.assert_allclose(pinhole.project(k, point), [u, v, z], atol=1e-8)
    np.testing.assert_allclose(point / z, np.linalg.inv(k) @ [u, v, 1], atol=1e-9)


@given(st.integers(1, 9), st.integers(1, 9), st.data())
def test_the_four_pixels_interpolate_a_plane(height: int, width: int, data: st.DataObject) -> None:
    u = data.draw(st.floats(0, width - 1, allow_subnormal=False))
    v = data.draw(st.floats(0, height - 1, allow_subnormal=False))
    grid = pinhole.pixel_grid(height, width)
    plane = (2 * grid[..., 0] - 3 * grid[..., 1] + 1).ravel()
    index = pinhole.four_pixels(np.array([[u, v]]), height, width)[:, 0]
    du, dv = u % 1, v % 1
    weight = np.outer([1 - dv, dv], [1 - du, du]).ravel()
    np.testing.assert_allclose(plane[index] @ weight, 2 * u - 3 * v + 1, atol=1e-9)


def test_an_image_reaches_half_a_pixel_about_its_pixels() -> None:
    at = np.array([[-0.5, 0], [-0.51, 0], [2.49, 0], [2.5, 0], [0, 1.5], [np.nan, 0]])
    assert pinhole.inside_image(at, 2, 3).tolist() == [True, False, True, False, False, False]
    index = pinhole.four_pixels(at, 2, 3)
    assert index.min() == 0 and index.max() < 6
