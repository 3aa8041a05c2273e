"""The compiled loops against the formulas that they stand for, and chains from motions alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.surfaces import Surfaces, surfaces_from_depth
from gcbench.gcpose.rgbd.labels import Candidates, label_costs
from gcbench.gcpose.rgbd.residuals import (
    accumulate_equations,
    flow_equations,
    sort_surfels,
    surface_equations,
    thin_surfels,
)
from gcbench.gcpose.rgbd.settings import BundleSettings, RgbdSettings
from gcbench.robots.geometry import Array, se3

INTRINSICS = np.array([[200.0, 0, 79.5], [0, 200.0, 59.5], [0, 0, 1]])


def bumpy(frames: int) -> Surfaces:
    """A smooth relief that differs from frame to frame."""
    v, u = np.mgrid[:120, :160]
    depth = np.stack([1.5 + 0.1 * np.sin(u / 25 + 0.2 * t) + 0.08 * np.cos(v / 20 - 0.1 * t)
                      for t in range(frames)])
    rng = np.random.default_rng(0)
    flow = rng.normal(0, 2, (frames - 1, 120, 160, 2)).astype(np.float32)
    exact = surfaces_from_depth(depth.astype(np.float32), INTRINSICS, ImageSettings())
    return replace(exact, flow=flow, noise=0.05)


def cloud(surfaces: Surfaces, frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals [N 3] and labels [N] of a frame, of parts 0..2."""
    rng = np.random.default_rng(1)
    pixel = rng.integers([30, 30], [130, 90], (300, 2))
    normal = surfaces.normal[frame, pixel[:, 1], pixel[:, 0]].astype(np.float64)
    return surfaces.points(frame, pixel), normal, rng.integers(0, 3, 300)


def motions(frames: int) -> np.ndarray:
    twist = np.random.default_rng(2).normal(0, 0.02, (frames, 3, 6))
    twist[:, 0] = 0.0
    return se3.exp(twist)


def surface_cost(
    surfaces: Surfaces, t: int, motion: np.ndarray, points: np.ndarray, normals: np.ndarray,
    own: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual [N], its row [N 6] and whether it counts, as `surface_equations` says; along the
    points' own normals as `accumulate_equations` says."""
    p = points @ motion[:3, :3].T + motion[:3, 3]
    n = normals @ motion[:3, :3].T
    u = np.rint(200 * p[:, 0] / p[:, 2] + 79.5).astype(int)
    v = np.rint(200 * p[:, 1] / p[:, 2] + 59.5).astype(int)
    d, m = surfaces.depth[t, v, u], surfaces.normal[t, v, u].astype(float)
    seen = np.stack([(u - 79.5) / 200 * d, (v - 59.5) / 200 * d, d], axis=1)
    hit = (n * m).sum(axis=1) > 0.6
    m = n if own else m
    return (m * (seen - p)).sum(axis=1), np.concatenate([np.cross(p, m), m], axis=1), hit


def test_surface_equations_are_the_sums_of_their_rows() -> None:
    surfaces, motion = bumpy(4), motions(4)
    points, normals, label = cloud(surfaces, 1)
    sigma = np.random.default_rng(3).uniform(0.005, 0.05, 300)
    these = sort_surfels(points, normals, sigma, label, 3)
    matrix, vector = surface_equations(surfaces, 1, motion, these, BundleSettings())
    assert not matrix[1].any() and not matrix[:, 0].any()
    for t in (0, 2, 3):
        for j in (1, 2):
            r, row, hit = surface_cost(surfaces, t, motion[t, j], points, normals)
            w = hit * (label == j) / ((1 + (r / sigma) ** 2) * sigma) ** 2
            assert np.allclose(matrix[t, j], (row * w[:, None]).T @ row, rtol=1e-3)
            assert np.allclose(vector[t, j], (row * w[:, None]).T @ r, rtol=1e-2, atol=1.0)


def test_accumulated_equations_are_those_of_points_that_may_be_displaced() -> None:
    surfaces, motion = bumpy(4), motions(4)
    motion[1] = np.eye(4)
    points, normals, label = cloud(surfaces, 1)
    sigma = np.full(300, 0.03)
    (matrix, vector), coupling = accumulate_equations(
        surfaces, motion, sort_surfels(points, normals, sigma, label, 3), BundleSettings())
    for j in (1, 2):
        mine = label == j
        n = int(mine.sum())
        full, right = np.zeros((24 + n, 24 + n)), np.zeros(24 + n)
        for t in range(4):
            r, row, hit = surface_cost(surfaces, t, motion[t, j], points[mine], normals[mine], True)
            rows = np.zeros((n, 24 + n))
            rows[:, 6 * t : 6 * t + 6], rows[:, 24:] = row, np.eye(n)
            w = hit / ((1 + (r / 0.03) ** 2) * 0.03) ** 2
            full += (rows * w[:, None]).T @ rows
            right += (rows * w[:, None]).T @ r
        gain = full[:24, 24:] @ np.linalg.inv(full[24:, 24:])
        expected = full[:24, :24] - gain @ full[24:, :24]
        found = -coupling[j]
        for t in range(4):
            found[6 * t : 6 * t + 6, 6 * t : 6 * t + 6] += matrix[t, j]
        assert np.allclose(found, expected, rtol=2e-3, atol=1e-3 * np.abs(expected).max())
        along = right[:24] - gain @ right[24:]
        assert np.allclose(vector[:, j].ravel(), along, atol=2e-3 * np.abs(right).max())


def test_a_part_without_points_has_no_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    """`np.einsum` multiplies what is in memory at the address of an array of no numbers by a sum of
    zero: what is NaN there by chance makes NaN."""
    einsum = np.einsum

    def einsum_beside_nan(subscripts: str, *operands: Array) -> Array:
        out = np.asarray(einsum(subscripts, *operands))
        return out if all(o.size for o in operands) else np.full(out.shape, np.nan)

    monkeypatch.setattr(np, "einsum", einsum_beside_nan)
    surfaces, motion = bumpy(4), motions(4)
    points, normals, _ = cloud(surfaces, 1)
    all_on_one = sort_surfels(points, normals, np.full(300, 0.03), np.ones(300, np.int64), 3)
    (matrix, vector), coupling = accumulate_equations(
        surfaces, motion, all_on_one, BundleSettings())
    assert vector[:, 1].any() and np.isfinite(vector).all()
    assert not matrix[:, 2].any() and not vector[:, 2].any() and not coupling[2].any()


def test_what_falls_outside_the_image_says_nothing() -> None:
    surfaces = bumpy(2)
    points, normals, label = cloud(surfaces, 0)
    away = np.tile(np.eye(4), (2, 3, 1, 1))
    for shift in ([5.0, 0, 0], [0, -5.0, 0], [0, 0, -9.0], [1e30, 0, 0]):
        away[1, 1:, :3, 3] = shift
        these = sort_surfels(points, normals, np.full(300, 0.01), label, 3)
        assert not surface_equations(surfaces, 0, away, these, BundleSettings())[0].any()


def test_flow_equations_vanish_where_flow_is_as_predicted() -> None:
    surfaces, motion = bumpy(2), motions(2)
    motion[0] = np.eye(4)
    points, normals, label = cloud(surfaces, 0)
    these = sort_surfels(points, normals, np.full(300, 0.01), label, 3)

    def project(p: np.ndarray) -> np.ndarray:
        return p[:, :2] / p[:, 2:] * 200 + [79.5, 59.5]

    moved = np.einsum("nij,nj->ni", motion[1, label, :3, :3], points) + motion[1, label, :3, 3]
    at = np.rint(project(points)).astype(int)
    flow = np.full((1, 120, 160, 2), 50.0, np.float32)
    flow[0, at[:, 1], at[:, 0]] = project(moved) - project(points)
    exact = replace(surfaces, flow=flow)
    settings = BundleSettings(flow_stride=1, flow_share=1.0)
    matrix, vector = flow_equations(exact, motion, these, settings)
    off = flow_equations(replace(exact, flow=flow + 1.0), motion, these, settings)[1]
    assert matrix[0, 1:].any() and np.abs(vector).max() < 0.05 * np.abs(off).max()


def test_a_sparse_set_holds_every_so_manieth_element_of_each_part() -> None:
    surfaces = bumpy(2)
    points, normals, label = cloud(surfaces, 0)
    these = sort_surfels(points, normals, np.full(300, 0.01), label, 3)
    few = thin_surfels(these, 2)
    assert few.column.shape == (7, 150) and few.start[-1] == 150
    assert (np.abs(2 * few.start - these.start) <= 1).all()


def test_label_costs_are_least_for_what_moved_the_points() -> None:
    surfaces = bumpy(3)
    still = replace(surfaces, depth=surfaces.depth[:1].repeat(3, axis=0),
                    normal=surfaces.normal[:1].repeat(3, axis=0), noise=0.0)
    points, normals, _ = cloud(still, 0)
    grid = Candidates(0, np.zeros((300, 2), int), points, normals, 1, ImageSettings())
    motion = np.tile(np.eye(4), (3, 3, 1, 1))
    motion[1:, 1, 2, 3], motion[1:, 2, 0, 3] = 0.03, 9.0
    cost = label_costs(still, grid, motion, RgbdSettings())
    assert (cost[:, 0] < 0.1).all() and (cost[:, 1] > 1.0).all()
    assert (cost[:, 2] == 4.0).all()  # outside of both frames
    motion[1:, 2] = np.nan
    assert (label_costs(still, grid, motion, RgbdSettings())[:, 2] == 4.0).all()
