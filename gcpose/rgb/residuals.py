"""Bundle adjustment without depth (Sec. 3.4): displacements, axes and the depth of every point.

A point is a pixel of a key frame with an unknown inverse depth; the chain moves it to the other
frames, where flow and patches measure it. Each residual depends on the twists of its part and on
the point's own depth. Depths are eliminated by Schur's complement (Triggs et al., "Bundle
adjustment - a modern synthesis", 2000), so that a step costs little more than with known depth.
Scale is free: depths are about 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_lapack_funcs

from ...robots.geometry import Array
from ..chain import Articulation, relative_derivatives
from ..estimator import BundleEquations
from .door_edges import DoorEdges
from .kernels import accumulate
from .points import InverseDepthPoints, motions_from_frames
from .settings import RgbSettings

_SOLVE_POSITIVE: Any = get_lapack_funcs("posv", dtype=np.float64)


@dataclass(frozen=True)
class RayResiduals:
    """Distances of points with unknown depth from their measured places, px, and of their steps
    from flow (see `Residuals`)."""

    points: InverseDepthPoints
    intrinsics: Array
    """[3 3] px"""
    depth_sigma: float
    """Standard deviation of inverse depths about the expected ones"""
    smoothness: list[tuple[NDArray[np.intp], Array]]
    """See `smoothness_blocks`."""
    settings: RgbSettings
    edges: DoorEdges | None = None
    """Of a door"""

    def linearize(
        self, state: Articulation, basis: tuple[Array, ...], scale: float,
        prior: tuple[Array, Array],
    ) -> tuple[BundleEquations, Callable[[Array], RayResiduals]]:
        """Return the equations at a state, depths eliminated; the scale is in standard deviations
        of the residuals."""
        matrix, vector, coupling, h, g = self._assemble(state, basis, scale)
        matrix, vector = matrix + prior[0], vector + prior[1]
        if self.edges is not None:
            turns = slice(len(state.angle) - 1)
            by_turn = self.edges.equations(state.angle[:, 0], scale, self.settings)
            matrix[turns, turns] += by_turn[0]
            vector[turns] += by_turn[1]
        by_depth, alone = self._solve_depths(coupling, h, g)
        reduced = BundleEquations(matrix - coupling.T @ by_depth, vector - coupling.T @ alone,
                                  diagonal=np.diag(matrix))
        return reduced, lambda step: self._move_depths(alone - by_depth @ step)

    def _assemble(
        self, state: Articulation, basis: tuple[Array, ...], scale: float
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Matrix [U U] and vector [U] of displacements and axes, coupling [N U] with the inverse
        depths, and the depths' own diagonal [N] and vector [N], summed over frames."""
        points, k = self.points, self.intrinsics
        frames, joints = state.angle.shape
        motion = state.motions(frames)
        derivative = state.derivatives(motion, basis)
        size = derivative.shape[2]
        keys = np.unique(points.frame)
        key = np.searchsorted(keys, points.frame)
        from_key = motions_from_frames(state, keys)
        a, b, c, h, g = accumulate(
            points.ray, points.inverse_depth, points.label, key, from_key, float(k[0, 0]),
            k[:2, 2].astype(np.float64), points.flow, points.flow_information, points.place,
            self.settings.patch_weight * points.place_information, scale)
        matrix, vector = np.zeros((size, size)), np.zeros(size)
        coupling = np.zeros((len(points.ray), size))
        # flow depends on the twists in two frames, a place on those in one
        twists = 12 if points.flow_information.any() else 6
        for i, frame in enumerate(keys):
            each = relative_derivatives(derivative, from_key[i], derivative[frame : frame + 1])
            each = each.swapaxes(2, 3)
            each[frame] = 0.0
            for p in range(1, joints + 1):
                mine = np.flatnonzero((key == i) & (points.label == p))
                if not len(mine):
                    continue
                pair = np.zeros((frames, twists, size))
                pair[:, :6] = each[:, p]
                if twists > 6:
                    pair[:-1, 6:] = each[1:, p]
                flat = pair.reshape(-1, size)
                matrix += flat.T @ (a[i, p, :, :twists, :twists] @ pair).reshape(-1, size)
                vector += flat.T @ b[i, p, :, :twists].reshape(-1)
                coupling[mine] = c[mine, :, :twists].reshape(len(mine), -1) @ flat
        return matrix, vector, coupling, h, g

    def _solve_depths(self, coupling: Array, h: Array, g: Array) -> tuple[Array, Array]:
        """Changes of the depths: [N U] by the other unknowns, and [N] where those stay."""
        depth = self.points.inverse_depth
        h = h + 1 / self.depth_sigma**2
        g = g + (self.points.expected - depth) / self.depth_sigma**2
        by_depth, alone = np.empty_like(coupling), np.empty_like(g)
        for mine, smooth in self.smoothness:
            square = smooth + np.diag(h[mine])
            right = np.column_stack([coupling[mine], g[mine] - smooth @ depth[mine]])
            _, both, failure = _SOLVE_POSITIVE(square.T, right, overwrite_a=True)
            if failure:
                raise np.linalg.LinAlgError("the equations of the depths are not positive definite")
            by_depth[mine], alone[mine] = both[:, :-1], both[:, -1]
        return by_depth, alone

    def _move_depths(self, change: Array) -> RayResiduals:
        s, points = self.settings, self.points
        depth = np.clip(
            points.inverse_depth + np.clip(change, -s.max_depth_step, s.max_depth_step),
            s.min_inverse_depth, s.max_inverse_depth)
        return replace(self, points=replace(points, inverse_depth=depth))


def smoothness_blocks(
    points: InverseDepthPoints, settings: RgbSettings
) -> list[tuple[NDArray[np.intp], Array]]:
    """Return the points of each part in each key frame, and the matrix [n n] of the prior that
    neighbors among them have equal depths."""
    if not len(points.frame):
        return []
    names = points.frame * (points.label.max() + 1) + points.label
    _, group, count = np.unique(names, return_inverse=True, return_counts=True)
    order, first = np.argsort(group, kind="stable"), np.cumsum(count) - count
    place = np.empty(len(order), np.intp)
    place[order] = np.arange(len(order)) - np.repeat(first, count)  # of each point in its group
    near = [np.zeros((n, n)) for n in count]
    if points.neighbors is not None:
        pair = points.neighbors.tocoo()
        alike = group[pair.row] == group[pair.col]
        i, j = pair.row[alike], pair.col[alike]
        here = np.argsort(group[i], kind="stable")
        ends = np.cumsum(np.bincount(group[i], minlength=len(count)))[:-1]
        for square, some in zip(near, np.split(here, ends), strict=True):
            square[place[i[some]], place[j[some]]] = 1.0
    out: list[tuple[NDArray[np.intp], Array]] = []
    for mine, square in zip(np.split(order, first[1:]), near, strict=True):
        square /= (np.maximum(1.0, square.sum(axis=1, keepdims=True))
                   * settings.neighbor_depth_sigma**2)
        square = (square + square.T) / 2
        out.append((mine, np.diag(square.sum(axis=1)) - square))
    return out
