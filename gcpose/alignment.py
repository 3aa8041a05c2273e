"""Residuals of points that a hypothesis moves from frame 0 to frame t, and their normal equations.

Every residual's derivative is taken to the twist (w, v) of the point's part, T <- exp(twist) T: six
numbers a with dr = -a . twist. So the images enter the estimate only through a 6x6 matrix per part
and frame, whatever the unknowns are: rigid motions, joint angles, axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array
from .surface import Floats, Surfaces

_AGREE = 0.6  # least cosine between the normals of two measurements of one surface element


@dataclass(frozen=True)
class Alignment:
    """T frames, N points."""

    plane: Floats
    """[T N] point-to-plane distance of the measured surface, m; 0 where not `hit`."""
    row: Floats
    """[T N 6] derivative of `plane` to minus the twist."""
    gap: Floats
    """[T N] measured depth behind the predicted point, m; inf: nothing is there; NaN: outside."""
    hit: NDArray[np.bool_]
    """[T N] whether a surface element is there that faces as the moved one does."""
    turned: NDArray[np.bool_]
    """[T N] whether the moved surface element faces away: its own object hides it."""


def align(
    surfaces: Surfaces, frames: NDArray[np.int64], motion: Array, points: Array, normals: Array
) -> Alignment:
    """Projective association: each point [N 3], moved by motion [T 4 4], meets its pixel.

    A point that has turned to the back of a part meets the front, a part's thickness away: the
    normals [N 3] tell.
    """
    k = surfaces.intrinsics.astype(np.float32)
    height, width = surfaces.depth.shape[1:]
    turn, shift = motion[:, :3, :3].astype(np.float32), motion[:, :3, 3].astype(np.float32)
    x, y, z = (turn @ points.T.astype(np.float32) + shift[..., None]).swapaxes(0, 1)
    fx, fy, fz = (turn @ normals.T.astype(np.float32)).swapaxes(0, 1)
    far = np.maximum(z, np.float32(1e-3))
    u = np.rint(k[0, 0] * x / far + k[0, 2])
    v = np.rint(k[1, 1] * y / far + k[1, 2])
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    first = (frames * (height * width))[:, None]
    pixel = np.where(inside, v * width + u, 0).astype(np.int64) + first
    depth = surfaces.depth.reshape(-1).take(pixel)
    nx, ny, nz = np.moveaxis(surfaces.normal.reshape(-1, 3).take(pixel, axis=0), 2, 0)
    turned = fx * x + fy * y + fz * far < 0
    hit = inside & (depth > 0) & (fx * nx + fy * ny + fz * nz > _AGREE)
    a, b = (u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1]
    plane = nx * (a * depth - x) + ny * (b * depth - y) + nz * (depth - far)
    plane = np.where(hit, plane, np.float32(0.0))
    gap = np.where(depth > 0, depth - far, np.float32(np.inf))
    row = np.stack([y * nz - far * ny, far * nx - x * nz, x * ny - y * nx, nx, ny, nz], axis=2)
    return Alignment(plane, row, np.where(inside, gap, np.float32(np.nan)), hit, turned)


def project(intrinsics: Array, points: Floats) -> Floats:
    """Pixels [... 2] of points [... 3]."""
    focal = np.array([intrinsics[0, 0], intrinsics[1, 1]], np.float32)
    centre = np.array([intrinsics[0, 2], intrinsics[1, 2]], np.float32)
    return points[..., :2] / np.maximum(points[..., 2:], np.float32(1e-3)) * focal + centre


def flow_residuals(
    surfaces: Surfaces, frames: NDArray[np.int64], motion: Array, next_motion: Array, points: Array
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Flow against the motion of points [N 3] from frame t to t + 1 (Sec. 3.4, L_w).

    motion and next_motion [T 4 4] take the points to the frames t and t + 1. Returns the measured
    minus the predicted displacement [T 2N] px, its rows [T 2N 6] to the twist of the step, and
    whether each point is seen in frame t [T 2N].
    """
    assert surfaces.flow is not None
    k = surfaces.intrinsics
    height, width = surfaces.depth.shape[1:]
    one, two = (
        points.astype(np.float32)[None] @ m[:, :3, :3].swapaxes(1, 2) + m[:, None, :3, 3]
        for m in (motion.astype(np.float32), next_motion.astype(np.float32))
    )
    here, there = project(k, one), project(k, two)
    u = np.rint(np.clip(here[..., 0], -2, width + 1)).astype(np.int32)
    v = np.rint(np.clip(here[..., 1], -2, height + 1)).astype(np.int32)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    pixel = np.where(inside, v * width + u, 0) + (frames * (height * width))[:, None]
    gap = surfaces.depth.reshape(-1).take(pixel) - one[..., 2]
    seen = inside & (np.abs(gap) < 15 * surfaces.noise)
    residual = surfaces.flow.reshape(-1, 2).take(pixel, axis=0) - (there - here)
    z = np.maximum(two[..., 2], np.float32(1e-3))
    zero = np.zeros_like(z)
    du = np.stack([k[0, 0] / z, zero, -k[0, 0] * two[..., 0] / z**2], axis=-1).astype(np.float32)
    dv = np.stack([zero, k[1, 1] / z, -k[1, 1] * two[..., 1] / z**2], axis=-1).astype(np.float32)
    rows = [np.concatenate([cross(two, d), d], axis=2) for d in (du, dv)]
    return (
        np.concatenate([residual[..., 0], residual[..., 1]], axis=1),
        np.concatenate(rows, axis=1),
        np.concatenate([seen, seen], axis=1),
    )


def shade_residuals(
    surfaces: Surfaces, frames: NDArray[np.int64], motion: Array, points: Array, shade: Array
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Brightness of points [N 3] where motion [T 4 4] takes them against theirs [N] (L_b).

    Returns the difference [T N], its rows [T N 6] and whether each point is seen [T N].
    """
    assert surfaces.shade is not None
    k = surfaces.intrinsics
    height, width = surfaces.depth.shape[1:]
    m = motion.astype(np.float32)
    moved = points.astype(np.float32)[None] @ m[:, :3, :3].swapaxes(1, 2) + m[:, None, :3, 3]
    at = project(k, moved)
    near = np.rint(np.clip(at, -2, max(height, width) + 1)).astype(np.int32)
    u, v = near[..., 0], near[..., 1]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    pixel = np.where(inside, v * width + u, 0) + (frames * (height * width))[:, None]
    gap = surfaces.depth.reshape(-1).take(pixel) - moved[..., 2]
    known = surfaces.normal.reshape(-1, 3).take(pixel, axis=0).any(axis=2)
    seen = inside & known & (np.abs(gap) < 6 * surfaces.noise)
    s = surfaces.shade.reshape(-1, 3).take(pixel, axis=0)
    there = s[..., 0] + s[..., 1] * (at[..., 0] - u) + s[..., 2] * (at[..., 1] - v)
    z = np.maximum(moved[..., 2], np.float32(1e-3))
    du, dv = s[..., 1] * np.float32(k[0, 0]) / z, s[..., 2] * np.float32(k[1, 1]) / z
    slope = np.stack([du, dv, -(du * moved[..., 0] + dv * moved[..., 1]) / z], axis=2)
    row = np.concatenate([cross(moved, slope), slope], axis=2)
    return shade.astype(np.float32)[None] - there, row, seen


def cross(a: Floats, b: Floats) -> Floats:
    """a x b over the last axis (np.cross is several times slower)."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def robust_weight(residual: Floats, scale: Floats | float) -> Floats:
    """Geman-McClure's weight, over the variance."""
    return 1.0 / (1.0 + (residual / scale) ** 2) ** 2 / np.square(scale)


def normal_equations(row: Floats, residual: Floats, weight: Floats) -> tuple[Array, Array]:
    """A [T 6 6] and b [T 6] of rows [T N 6], residuals [T N], weights [T N]."""
    weighted = (row * weight[..., None]).swapaxes(1, 2)
    matrix = (weighted @ row).astype(np.float64)
    return matrix, (weighted @ residual[..., None])[..., 0].astype(np.float64)
