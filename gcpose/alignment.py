"""What images say of a motion: residuals of moved points, summed into normal equations.

Every residual's derivative is taken to the twist (w, v) of the point's part, T <- exp(twist) T: six
numbers a with dr = -a . twist. So the images enter the estimate only through a 6x6 matrix per part
and frame, whatever the unknowns are: rigid motions, joint angles, axes.

All of them move points by motion [T J+1 4 4] into frames 0..T-1, but for the frame that the points
are from, and add up over each part: matrix [T J+1 6 6], vector [T J+1 6], with Geman-McClure's
weights. Part 0 stands still and says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array
from .compiled import Number, compiled
from .sight import (
    NEAR,
    Camera,
    camera_of,
    columns,
    look,
    matrix_of,
    moved,
    sight_of,
    turned,
)
from .surface import Image, Surfaces

AGREE = np.float32(0.6)  # least cosine between the normals of two measurements of one surface
_NIL = np.float32(0)

Equations = tuple[Array, Array]


@dataclass(frozen=True)
class Elements:
    """Surface elements sorted by part."""

    column: Image
    """[7 N] point, normal, sigma of the distance in m"""
    start: NDArray[np.int64]
    """[J+2] where each part begins."""


def elements(
    point: Array, normal: Array, sigma: Array, label: NDArray[np.int64], parts: int
) -> Elements:
    """Of points and normals [N 3], sigma and label [N] on as many parts."""
    order = np.argsort(label, kind="stable")
    start = np.searchsorted(label[order], np.arange(parts + 1))
    return Elements(columns(point, normal, sigma)[:, order], start)


def sparse(these: Elements, stride: int) -> Elements:
    """Every so manieth of them."""
    return Elements(np.ascontiguousarray(these.column[:, ::stride]), -(-these.start // stride))


def surface_equations(
    surfaces: Surfaces, frame: int, motion: Array, these: Elements
) -> Equations:
    """Point-to-plane distance of the measured surface; projective association.

    A point that has turned to the back of a part meets the front, a part's thickness away: the
    normals tell.
    """
    out = empty(motion.shape)
    _surface(surfaces.depth, surfaces.normal, camera_of(surfaces.intrinsics, surfaces.depth),
             frame, motion.astype(np.float32), these.column, these.start, *out)
    return out


def flow_equations(
    surfaces: Surfaces, motion: Array, these: Elements, sigma: float, share: float
) -> Equations:
    """Flow from frame t to t + 1 against the motion between (Sec. 3.4, L_w), for t = 0..T-2.

    Twists are of the steps. sigma in px; `share` of the pixels errs independently.
    """
    assert surfaces.flow is not None
    out = empty(motion[1:].shape)
    _flow(surfaces.depth, surfaces.normal, surfaces.flow,
          camera_of(surfaces.intrinsics, surfaces.depth), motion.astype(np.float32),
          these.column, these.start,
          np.float32(15 * surfaces.noise), np.float32(sigma), np.float32(share), *out)
    return out


def empty(shape: tuple[int, ...]) -> Equations:
    """Sums over nothing yet, for motion of that shape."""
    return np.zeros((*shape[:2], 6, 6)), np.zeros((*shape[:2], 6))


class Rows(NamedTuple):
    """Residuals and their derivatives, each times the root of its weight."""

    turn_x: Image
    turn_y: Image
    turn_z: Image
    slide_x: Image
    slide_y: Image
    slide_z: Image
    residual: Image


@compiled
def rows_of(n: int) -> Rows:
    """Room for n of them."""
    f = np.float32
    return Rows(np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f),
                np.empty(n, f), np.empty(n, f))


@compiled
def fill(
    rows: Rows, i: int, x: Number, y: Number, z: Number, a: Number, b: Number, c: Number,
    residual: Number, weight: Number,
) -> None:
    """Row i: a residual that falls by (a, b, c) per metre that its point (x, y, z) moves."""
    rows.turn_x[i] = weight * (y * c - z * b)
    rows.turn_y[i] = weight * (z * a - x * c)
    rows.turn_z[i] = weight * (x * b - y * a)
    rows.slide_x[i] = weight * a
    rows.slide_y[i] = weight * b
    rows.slide_z[i] = weight * c
    rows.residual[i] = weight * residual


@compiled
def dot(a: Image, b: Image, many: int) -> Number:
    """Of the first `many` numbers."""
    out = np.float32(0)
    for i in range(many):
        out += a[i] * b[i]
    return out


@compiled
def total(rows: Rows, many: int, matrix: Array, vector: Array) -> None:
    """Add the normal equations of the first `many` rows to [6 6] and [6]."""
    for a in range(6):
        vector[a] += dot(rows[a], rows[6], many)
        for b in range(a, 6):
            product = dot(rows[a], rows[b], many)
            matrix[a, b] += product
            if a < b:
                matrix[b, a] += product


@compiled
def root_weight(residual: Number, sigma: Number) -> Number:
    """Root of Geman-McClure's weight over the variance."""
    ratio = residual / sigma
    return np.float32(1) / ((np.float32(1) + ratio * ratio) * sigma)


@compiled
def _surface(
    depth: Image, normal: Image, camera: Camera, frame: int, motion: Image, column: Image,
    start: NDArray[np.int64], matrix: Array, vector: Array,
) -> None:
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    sight, rows = sight_of(column.shape[1]), rows_of(column.shape[1])
    for t in range(len(motion)):
        if t == frame:
            continue
        for j in range(1, motion.shape[1]):
            m, here = matrix_of(motion[t, j]), column[:, start[j] : start[j + 1]]
            look(sight, m, camera, here, depth[t].ravel(), normal[t].ravel())
            qx, qy, qz, sigma = here[3], here[4], here[5], here[6]
            for i in range(len(qx)):
                x, y, z, d = sight.x[i], sight.y[i], sight.z[i], sight.depth[i]
                a, b = (np.rint(sight.u[i]) - cx) / fx, (np.rint(sight.v[i]) - cy) / fy
                nx, ny, nz = sight.normal_x[i], sight.normal_y[i], sight.normal_z[i]
                mx, my, mz = turned(m, qx[i], qy[i], qz[i])
                hit = sight.inside[i] & (d > 0) & (mx * nx + my * ny + mz * nz > AGREE)
                residual = nx * (a * d - x) + ny * (b * d - y) + nz * (d - z)
                weight = root_weight(residual, sigma[i]) if hit else _NIL
                fill(rows, i, x, y, z, nx, ny, nz, residual, weight)
            total(rows, len(qx), matrix[t, j], vector[t, j])


@compiled
def _flow(
    depth: Image, normal: Image, flow: Image, camera: Camera, motion: Image, column: Image,
    start: NDArray[np.int64], reach: Number, sigma: Number, share: Number, matrix: Array,
    vector: Array,
) -> None:
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    n, root = column.shape[1], np.sqrt(share)
    sight, across, down = sight_of(n), rows_of(n), rows_of(n)
    du, dv = np.empty(n, np.float32), np.empty(n, np.float32)
    for t in range(len(motion) - 1):
        moves = flow[t].ravel()
        for j in range(1, motion.shape[1]):
            after, here = matrix_of(motion[t + 1, j]), column[:, start[j] : start[j + 1]]
            look(sight, matrix_of(motion[t, j]), camera, here, depth[t].ravel(),
                 normal[t].ravel())
            px, py, pz = here[0], here[1], here[2]
            for i in range(len(px)):
                du[i], dv[i] = moves[2 * sight.pixel[i]], moves[2 * sight.pixel[i] + 1]
            for i in range(len(px)):
                hit = sight.inside[i] & (abs(sight.depth[i] - sight.z[i]) < reach)
                x, y, z = moved(after, px[i], py[i], pz[i])
                z = max(z, NEAR)
                scale = root if hit else _NIL
                residual = du[i] - (fx * x / z + cx - sight.u[i])
                weight = scale * root_weight(residual, sigma)
                fill(across, i, x, y, z, fx / z, _NIL, -fx * x / (z * z), residual, weight)
                residual = dv[i] - (fy * y / z + cy - sight.v[i])
                weight = scale * root_weight(residual, sigma)
                fill(down, i, x, y, z, _NIL, fy / z, -fy * y / (z * z), residual, weight)
            total(across, len(px), matrix[t, j], vector[t, j])
            total(down, len(px), matrix[t, j], vector[t, j])
