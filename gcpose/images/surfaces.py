"""What depth images say: a surface element (point, normal) at every pixel of every frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image, together

_STEEPEST = 0.12  # cosine between normal and ray under which a pixel's normal is not trusted


@dataclass(frozen=True)
class Surfaces:
    """T frames of H x W pixels."""

    depth: Image
    """[T H W] m, 0 = no surface."""
    normal: Image
    """[T H W 3] unit, away from the camera; zeros where unknown."""
    intrinsics: Array
    """[3 3] px"""
    noise: float
    """Standard deviation of the depth, m."""
    flow: Image | None = None
    """[T-1 H W 2] to the next frame, px, where depth alone is too poor."""

    @property
    def frames(self) -> int:
        return len(self.depth)

    def footprint(self, z: Array) -> Array:
        """Size of a pixel on a surface at depth z, m."""
        return z / float(self.intrinsics[0, 0])

    def tolerance(self, z: Image) -> Image:
        """What two measurements of a still surface at depth z [...] never differ by, m."""
        return np.float32(0.5 / self.intrinsics[0, 0]) * z + np.float32(5e-4 + 5 * self.noise)

    def points(self, frame: int, pixel: NDArray[np.int64]) -> Array:
        """Points [N 3] of a frame at the pixels (u, v) [N 2]."""
        z = self.depth[frame, pixel[:, 1], pixel[:, 0]].astype(np.float64)
        return rays(self.intrinsics, pixel) * z[:, None]


def rays(intrinsics: Array, pixel: Array | NDArray[np.int64]) -> Array:
    """[N 3] points at depth 1 behind the pixels (u, v) [N 2]."""
    x = (pixel[:, 0] - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (pixel[:, 1] - intrinsics[1, 2]) / intrinsics[1, 1]
    return np.stack([x, y, np.ones_like(x)], axis=1)


def surface_normals(depth: Image, intrinsics: Array, rough: float) -> Image:
    """Normals [H W 3] of a depth image [H W].

    Where n . X = d, the inverse depth (n / d) . ray is affine in the pixel: its gradient is the
    normal. A pixel whose neighbours do not continue it within `rough` (relative depth) has none.
    """
    valid = depth > 0
    q = np.where(valid, 1.0 / np.where(valid, depth, 1.0), 0.0).astype(np.float32)
    du, dv = np.zeros_like(q), np.zeros_like(q)
    ok = valid.copy()
    ok[[0, -1]] = ok[:, [0, -1]] = False
    du[:, 1:-1] = q[:, 2:] - q[:, :-2]
    dv[1:-1] = q[2:] - q[:-2]
    bend_u = np.abs(q[:, 2:] + q[:, :-2] - 2 * q[:, 1:-1])
    bend_v = np.abs(q[2:] + q[:-2] - 2 * q[1:-1])
    ok[:, 1:-1] &= bend_u < rough * q[:, 1:-1]
    ok[1:-1] &= bend_v < rough * q[1:-1]
    a = du * np.float32(0.5 * intrinsics[0, 0])
    b = dv * np.float32(0.5 * intrinsics[1, 1])
    height, width = depth.shape
    x = ((np.arange(width) - intrinsics[0, 2]) / intrinsics[0, 0]).astype(np.float32)
    y = ((np.arange(height) - intrinsics[1, 2]) / intrinsics[1, 1]).astype(np.float32)[:, None]
    n = np.stack([a, b, q - a * x - b * y], axis=2)
    length = np.sqrt(np.einsum("hwc,hwc->hw", n, n))
    facing = q > _STEEPEST * length * np.sqrt(1 + x * x + y * y)  # n . ray = q
    n /= np.maximum(length, 1e-12)[..., None]
    n[~(ok & facing)] = 0
    return n


def measure(depth: Image, intrinsics: Array) -> Surfaces:
    """Surfaces of exact depth [T H W]."""
    f = float(intrinsics[0, 0])
    normal = np.stack(together(lambda d: surface_normals(d, intrinsics, 2.0 / f), depth))
    return Surfaces(np.ascontiguousarray(depth, np.float32), normal, intrinsics, 0.0)
