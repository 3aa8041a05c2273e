"""Points of key frames without depth: where a chain takes them, and how they look there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ...robots.geometry import Array, inverse
from ..chain import Articulation

_NOISE = 0.03  # of inverse depths, from a plane through their neighbours'
_STEEP, _STEEPEST = 2.0, 4.0  # slopes of inverse depth, by ray: usual, and the most there is


@dataclass(frozen=True)
class Rays:
    """N pixels of key frames, and what the T frames say of them."""

    frame: NDArray[np.int64]
    """[N] key frame of each"""
    ray: Array
    """[N 3] at depth 1"""
    label: NDArray[np.int64]
    """[N] 1..J"""
    inverse_depth: Array
    """[N] in the key frame; scale is free: about 1"""
    expected: Array
    """[N] what is believed of it beforehand"""
    step: Array
    """[N T-1 2] px, flow where the point is in each frame"""
    step_information: Array
    """[N T-1 2 2] 1/px2"""
    spot: Array
    """[N T 2] px, where the point was found in each frame"""
    spot_information: Array
    """[N T 2 2] 1/px2"""
    near: csr_array | None = None
    """[N N] 1 for neighbours in a key frame, whose depths are alike on one part"""

    @classmethod
    def unseen(
        cls, frame: NDArray[np.int64], ray: Array, label: NDArray[np.int64], expected: Array
    ) -> Rays:
        """Those of which nothing is measured yet."""
        none = np.zeros(0)
        return cls(frame, ray, label, expected, expected, none, none, none, none)


def carried(state: Articulation, rays: Rays) -> Array:
    """[N T 4 4] motion of each point's part from its key frame to each frame."""
    motion = state.motions(len(state.angle))
    keys, key = np.unique(rays.frame, return_inverse=True)
    return (motion @ inverse(motion[keys])[:, None])[key, :, rays.label]


def places(state: Articulation, rays: Rays, intrinsics: Array) -> Array:
    """[N T 2] px, where each point is in each frame."""
    return _seen(carried(state, rays), rays)[0] * intrinsics[[0, 1], [0, 1]] + intrinsics[:2, 2]


def warps(state: Articulation, rays: Rays) -> Array:
    """[N T 2 2], how a point's surroundings in its key frame are distorted in each frame.

    They lie in a plane (see `slopes`): of its points inverse depth is linear in the ray.
    """
    motion = carried(state, rays)
    at, depth = _seen(motion, rays)
    by_ray = motion[..., :3, :2] + motion[..., :3, 3:] * slopes(rays)[:, None, None]
    return (by_ray[..., :2, :] - at[..., None] * by_ray[..., 2:, :]) / depth[..., None]


def _seen(motion: Array, rays: Rays) -> tuple[Array, Array]:
    """[N T 2] at depth 1, and [N T 1] depth, of the depth in the key frame."""
    moved = np.einsum("ntab,nb->nta", motion[..., :3, :3], rays.ray)
    moved += rays.inverse_depth[:, None, None] * motion[..., :3, 3]
    depth = np.maximum(moved[..., 2:], 0.05)
    return moved[..., :2] / depth, depth


def slopes(rays: Rays) -> Array:
    """[N 2] by how much inverse depth grows with the ray's x and y, on the part of each point.

    Of a plane through what is near, as far as that tells more than that slopes are small.
    """
    if rays.near is None:
        return np.zeros((len(rays.ray), 2))
    pair = csr_array(rays.near @ rays.near).tocoo()
    i, j = pair.row, pair.col
    alike = rays.label[i] == rays.label[j]
    i, j = i[alike], j[alike]
    value = np.column_stack([rays.ray[:, :2], rays.inverse_depth])
    size = len(value)
    count = np.maximum(1, np.bincount(i, minlength=size))
    mean = np.stack([np.bincount(i, value[j, c], size) for c in range(3)], axis=1) / count[:, None]
    off = value[j] - mean[i]
    xx, xy, yy, xq, yq = (np.bincount(i, off[:, a] * off[:, b], size)
                          for a, b in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2)))
    little = (_NOISE / _STEEP) ** 2
    xx, yy = xx + little, yy + little
    slope = np.stack([yy * xq - xy * yq, xx * yq - xy * xq], axis=1) / (xx * yy - xy**2)[:, None]
    steep = np.linalg.norm(slope, axis=1, keepdims=True)
    return slope * np.minimum(1.0, _STEEPEST / np.maximum(steep, _STEEPEST))
