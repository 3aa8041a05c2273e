"""Bundle adjustment without depth (Sec. 3.4): displacements, axes and the depth of every point.

A point is a pixel of a key frame with an unknown inverse depth; the chain moves it to the other
frames, where flow and patches measure it. Each residual depends on the twists of its part and on
the point's own depth. Depths are eliminated by Schur's complement (Triggs et al., "Bundle
adjustment - a modern synthesis", 2000), so that a step costs little more than with known depth.
Scale is free: depths are about 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import (
    Articulation,
    HingePrior,
    axis_bases,
    prior_equations,
    relative_derivatives,
    take_step,
)
from ..estimator import BundleEquations
from ..numerics import Solver
from .kernels import accumulate
from .points import InverseDepthPoints, motions_from_frames
from .settings import RgbSettings


@dataclass(frozen=True)
class BundleSetup:
    """Camera and joints of an adjustment."""

    intrinsics: Array
    """[3 3] px"""
    axis_dof: int
    """Free parameters of an axis: 0, 2 or 4"""
    hinges: HingePrior


@dataclass(frozen=True)
class BundleWeights:
    """Scales and priors of an adjustment."""

    scales: tuple[float, ...]
    """Robust scale of each iteration, in standard deviations of the residuals"""
    depth_sigma: float
    """Standard deviation of inverse depths about the expected ones"""
    prior: float = 1.0
    """Weight of the priors on motion and axes"""


@dataclass(frozen=True)
class BundleFit:
    """Result of an adjustment."""

    state: Articulation
    inverse_depth: Array
    """[N]"""
    equations: BundleEquations | None
    """The last ones, depths eliminated"""


@dataclass(frozen=True)
class _Equations:
    """Normal equations of U displacements and axes, and of N inverse depths."""

    matrix: Array
    """[U U]"""
    vector: Array
    """[U]"""
    coupling: Array
    """[N U]"""
    h: Array
    """[N]"""
    g: Array
    """[N]"""


def adjust_points(
    state: Articulation, points: InverseDepthPoints, setup: BundleSetup, weights: BundleWeights,
    settings: RgbSettings,
) -> BundleFit:
    """Adjust an articulation and the depths of its points to the points' measurements by
    Gauss-Newton, one iteration for each robust scale."""
    depth = points.inverse_depth.copy()
    reduced = None
    blocks = _smoothness_blocks(points, settings)
    low, high = settings.min_inverse_depth, settings.max_inverse_depth
    solver = Solver(settings.damping, 1e-6, max_step=settings.max_step, scaled=True)
    for scale in weights.scales:
        basis = axis_bases(state, setup.hinges.point, setup.axis_dof)
        moved = replace(points, inverse_depth=depth)
        equations = _assemble(state, moved, setup.intrinsics, basis, scale)
        matrix, vector = prior_equations(state, basis, setup.hinges, settings.chain)
        equations.matrix[:] += weights.prior * matrix
        equations.vector[:] += weights.prior * vector
        by_depth, alone = _solve_depths(equations, moved, blocks, weights.depth_sigma)
        reduced = BundleEquations(
            equations.matrix - equations.coupling.T @ by_depth,
            equations.vector - equations.coupling.T @ alone, diagonal=np.diag(equations.matrix))
        step = solver.step(reduced.matrix, reduced.vector, diagonal=reduced.diagonal)
        change = alone - by_depth @ step
        most = settings.max_depth_step
        depth = np.clip(depth + np.clip(change, -most, most), low, high)
        state = take_step(state, basis, step)
    return BundleFit(state, depth, reduced)


def _solve_depths(
    equations: _Equations, points: InverseDepthPoints,
    blocks: list[tuple[NDArray[np.intp], Array]], sigma: float,
) -> tuple[Array, Array]:
    """Changes of the depths: [N U] by the other unknowns, and [N] where those stay."""
    depth = points.inverse_depth
    h = equations.h + 1 / sigma**2
    g = equations.g + (points.expected - depth) / sigma**2
    by_depth, alone = np.empty_like(equations.coupling), np.empty_like(g)
    for mine, smooth in blocks:
        square = smooth + np.diag(h[mine])
        both = np.linalg.solve(square, np.column_stack(
            [equations.coupling[mine], g[mine] - smooth @ depth[mine]]))
        by_depth[mine], alone[mine] = both[:, :-1], both[:, -1]
    return by_depth, alone


def _smoothness_blocks(
    points: InverseDepthPoints, settings: RgbSettings
) -> list[tuple[NDArray[np.intp], Array]]:
    """Of each key frame its points, and the matrix [n n] of the prior that neighbors on one part
    have equal depths."""
    out: list[tuple[NDArray[np.intp], Array]] = []
    for k in np.unique(points.frame):
        mine = np.flatnonzero(points.frame == k)
        smooth = np.zeros((len(mine), len(mine)))
        if points.neighbors is not None:
            near = points.neighbors[mine][:, mine].toarray()
            near *= points.label[mine, None] == points.label[mine]
            near /= (np.maximum(1.0, near.sum(axis=1, keepdims=True))
                     * settings.neighbor_depth_sigma**2)
            near = (near + near.T) / 2
            smooth = np.diag(near.sum(axis=1)) - near
        out.append((mine, smooth))
    return out


def _assemble(
    state: Articulation, points: InverseDepthPoints, intrinsics: Array, basis: tuple[Array, ...],
    scale: float,
) -> _Equations:
    """Sum the points' equations over frames, in terms of displacements and axes."""
    frames, joints = state.angle.shape
    motion = state.motions(frames)
    derivative = state.derivatives(motion, basis)
    size = derivative.shape[2]
    keys = np.unique(points.frame)
    key = np.searchsorted(keys, points.frame)
    from_key = motions_from_frames(state, keys)
    a, b, c, h, g = accumulate(
        points.ray, points.inverse_depth, points.label, key, from_key,
        float(intrinsics[0, 0]), intrinsics[:2, 2].astype(np.float64), points.flow,
        points.flow_information, points.place, points.place_information, scale)
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    coupling = np.zeros((len(points.ray), size))
    for k, frame in enumerate(keys):
        each = relative_derivatives(derivative, from_key[k], derivative[frame : frame + 1])
        each = each.swapaxes(2, 3)
        each[frame] = 0.0
        for p in range(1, joints + 1):
            pair = np.zeros((frames, 12, size))
            pair[:, :6] = each[:, p]
            pair[:-1, 6:] = each[1:, p]
            flat = pair.reshape(-1, size)
            matrix += flat.T @ (a[k, p] @ pair).reshape(-1, size)
            vector += flat.T @ b[k, p].reshape(-1)
            mine = (key == k) & (points.label == p)
            coupling[mine] = c[mine].reshape(np.count_nonzero(mine), 12 * frames) @ flat
    return _Equations(matrix, vector, coupling, h, g)
