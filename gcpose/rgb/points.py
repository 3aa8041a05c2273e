"""Points of key frames with unknown depth, and where an articulation predicts them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from ...robots.geometry import Array, inverse
from ..chain import Articulation
from .kernels import fit_slopes
from .outline import Outline
from .projection import distort, project_rays
from .settings import RgbSettings

_INTERPOLATED = 4  # points whose depths are interpolated


@dataclass(frozen=True)
class InverseDepthPoints:
    """N pixels of key frames with an inverse depth each (Civera et al., T-RO 2008), and what T
    frames measure of them."""

    frame: NDArray[np.int64]
    """[N] key frame"""
    ray: Array
    """[N 3] at depth 1"""
    label: NDArray[np.int64]
    """[N] part 1..J"""
    inverse_depth: Array
    """[N] in the key frame; scale is free: about 1"""
    expected: Array
    """[N] prior mean of the inverse depth"""
    flow: Array
    """[N T-1 2] px, flow at the point's place in each frame"""
    flow_information: Array
    """[N T-1 2 2] 1/px^2"""
    place: Array
    """[N T 2] px, where the point's patch was found in each frame"""
    place_information: Array
    """[N T 2 2] 1/px^2"""
    outline: Outline
    """Which points are on the outline: of these, its place across its direction is measured"""
    neighbors: csr_array | None = None
    """[N N] 1 for neighbors in a key frame, whose depths are alike on one part"""

    @classmethod
    def without_measurements(
        cls, frame: NDArray[np.int64], ray: Array, label: NDArray[np.int64], expected: Array
    ) -> InverseDepthPoints:
        """Return points at their expected depths, without measurements."""
        none = np.zeros(0)
        return cls(frame, ray, label, expected, expected, none, none, none, none,
                   Outline.none(len(ray)))


def motions_from_frames(state: Articulation, keys: NDArray[np.int64]) -> Array:
    """Return the motions [K T J+1 4 4] of all parts from each of K frames to each frame."""
    motion = state.motions(len(state.angle))
    return motion @ inverse(motion[keys])[:, None]


def motions_from_keys(
    state: Articulation, points: InverseDepthPoints
) -> tuple[Array, NDArray[np.int64]]:
    """Return the motions [K T J+1 4 4] from the key frames, and the index [N] of each point's."""
    keys, key = np.unique(points.frame, return_inverse=True)
    return motions_from_frames(state, keys), key


def predict_places(state: Articulation, points: InverseDepthPoints, intrinsics: Array) -> Array:
    """Return the place [N T 2], px, of each point in each frame."""
    motion, key = motions_from_keys(state, points)
    return project_rays(motion, key, points.label[:, None], points.ray,
                        points.inverse_depth[:, None], intrinsics)[:, :, 0]


def predict_warps(state: Articulation, points: InverseDepthPoints, slope: Array) -> Array:
    """Return the distortion [N T 2 2] of each point's surroundings from its key frame.

    The surroundings lie in a plane, on which inverse depth is linear in the ray: with a slope [N 2]
    (see `inverse_depth_slopes`).
    """
    motion, key = motions_from_keys(state, points)
    return distort(motion, key, points.label, points.ray, points.inverse_depth, slope)


def inverse_depth_slopes(points: InverseDepthPoints, settings: RgbSettings) -> Array:
    """Return the slope [N 2] of inverse depth by the ray's x and y on the part of each point.

    A plane is fitted to the neighbors and their neighbors on the same part, with a prior towards
    slope 0. On the outline, where a surface is seen from the side, it is 0.
    """
    if points.neighbors is None:
        return np.zeros((len(points.ray), 2))
    slope = fit_slopes(
        points.neighbors.indptr, points.neighbors.indices, points.label,
        np.column_stack([points.ray[:, :2], points.inverse_depth]),
        (settings.plane_depth_sigma / settings.slope_sigma) ** 2)
    steep = np.linalg.norm(slope, axis=1, keepdims=True)
    slope *= np.minimum(1.0, settings.max_slope / np.maximum(steep, settings.max_slope))
    return np.where(points.outline.on[:, None], 0.0, slope)


def interpolate_depths(
    points: InverseDepthPoints, frame: NDArray[np.int64], ray: Array, otherwise: Array
) -> Array:
    """Return the inverse depths [N] of other pixels on rays [N 3], from the nearest of the points
    in the same key frame; `otherwise` [N] in other frames."""
    out = otherwise.copy()
    for f in np.intersect1d(frame, points.frame):
        own, other = points.frame == f, frame == f
        known = points.inverse_depth[own]
        away, near = KDTree(points.ray[own, :2]).query(
            ray[other, :2], min(_INTERPOLATED, len(known)))
        weight = 1 / (away.reshape(len(away), -1) + 1e-9)
        depths = known[near.reshape(weight.shape)]
        out[other] = (weight * depths).sum(axis=1) / weight.sum(axis=1)
    return out
