"""Compiled predictions: where parts move pixels of key frames, and how they distort patches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import compiled

_MIN_DEPTH = 0.05  # in units of the depth in the key frame; nearer points are moved to it


def project_rays(
    motion: Array, key: NDArray[np.int64], part: NDArray[np.int64], ray: Array,
    inverse_depth: Array, intrinsics: Array,
) -> Array:
    """Return the places [N T P 2], px, of N pixels of key frames in T frames, each on P parts.

    motion [K T J+1 4 4] of the parts from each of K key frames; key [N] index into it; part [N P];
    ray [N 3] at depth 1; inverse_depth [N P] in the key frame.
    """
    k = intrinsics
    return _project(motion, key, part, ray, inverse_depth,
                    (float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])))


@compiled
def distort(
    motion: Array, key: NDArray[np.int64], part: NDArray[np.int64], ray: Array,
    inverse_depth: Array, slope: Array,
) -> Array:
    """Return the distortion [N T 2 2] of the surroundings of N pixels, frame from key frame.

    Inverse depth is linear in the ray there, with a slope [N 2]; part [N] and inverse_depth [N],
    and the rest as in `project_rays`.
    """
    n, frames = len(ray), motion.shape[1]
    out = np.empty((n, frames, 2, 2))
    for i in range(n):
        for t in range(frames):
            m = motion[key[i], t, part[i]]
            x, y, z = _move(m, ray[i], inverse_depth[i])
            for b in range(2):
                by_z = m[2, b] + m[2, 3] * slope[i, b]
                out[i, t, 0, b] = (m[0, b] + m[0, 3] * slope[i, b] - x / z * by_z) / z
                out[i, t, 1, b] = (m[1, b] + m[1, 3] * slope[i, b] - y / z * by_z) / z
    return out


@compiled
def _project(
    motion: Array, key: NDArray[np.int64], part: NDArray[np.int64], ray: Array,
    inverse_depth: Array, camera: tuple[float, float, float, float],
) -> Array:
    n, parts, frames = part.shape[0], part.shape[1], motion.shape[1]
    focal_u, focal_v, cu, cv = camera
    out = np.empty((n, frames, parts, 2))
    for i in range(n):
        for t in range(frames):
            for p in range(parts):
                x, y, z = _move(motion[key[i], t, part[i, p]], ray[i], inverse_depth[i, p])
                out[i, t, p, 0] = focal_u * (x / z) + cu
                out[i, t, p, 1] = focal_v * (y / z) + cv
    return out


@compiled
def _move(m: Array, ray: Array, q: float) -> tuple[float, float, float]:
    """A point on a ray (z = 1) under a motion [4 4], in units of its depth in the key frame."""
    a, b = ray[0], ray[1]
    return (m[0, 0] * a + m[0, 1] * b + m[0, 2] + q * m[0, 3],
            m[1, 0] * a + m[1, 1] * b + m[1, 2] + q * m[1, 3],
            max(_MIN_DEPTH, m[2, 0] * a + m[2, 1] * b + m[2, 2] + q * m[2, 3]))
