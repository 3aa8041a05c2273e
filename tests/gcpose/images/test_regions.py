"""Ranks from the base and smoothed costs."""

from __future__ import annotations

import numpy as np
from gcbench.gcpose.images.regions import Candidates, geodesic_rank, smooth_costs
from gcbench.gcpose.images.settings import ImageSettings
from hypothesis import given, settings
from hypothesis import strategies as st


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.01, 100))
def test_ranks_keep_under_similarity(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    points, static = rng.random((40, 3)), rng.random((9, 3))
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rank = geodesic_rank(points, static, ImageSettings())
    assert rank.min() == 0 and rank.max() == 1
    moved = geodesic_rank(scale * points @ turn + 1, scale * static @ turn + 1, ImageSettings())
    assert np.mean(rank != moved) <= 0.1  # equal distances may change places


def test_ranks_follow_a_folded_body() -> None:
    """A chain that returns to its base: its end is far along the body."""
    bend = np.linspace(0, 1.8 * np.pi, 200)
    points = np.stack([np.cos(bend), np.sin(bend), 0 * bend], axis=1)
    rank = geodesic_rank(points, np.array([[1.05, 0.0, 0.0]]), ImageSettings())
    assert np.corrcoef(rank, bend)[0, 1] > 0.99


def test_smooth_costs_are_means_of_neighbors_on_the_grid() -> None:
    u, v = np.meshgrid(np.arange(13), np.arange(11))
    pixel = np.stack([u.ravel(), v.ravel()], axis=1) * 4
    n = len(pixel)
    grid = Candidates(0, pixel, np.zeros((n, 3)), np.zeros((n, 3)), 4, ImageSettings())
    for noisy in (False, True):
        assert np.allclose(smooth_costs(np.full((n, 2), 3.0), grid, noisy), 3.0)
    one = (np.arange(n) == n // 2)[:, None].astype(float)
    smooth = smooth_costs(one, grid)[:, 0].reshape(11, 13)
    expected = np.zeros_like(smooth)
    expected[3:8, 4:9] = 1 / 25
    assert np.allclose(smooth, expected)
