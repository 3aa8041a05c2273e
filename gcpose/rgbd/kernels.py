"""Inner loops of the search with depth, as machine code (see compiled.py).

Loops over points are written without branches, on plain numbers in single precision and one array
for each coordinate, so that the compiler does many points at once. That is most of what they gain
over NumPy; a `continue`, or a look-up beside a store, undoes it.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image, compiled

Number = float | np.floating[Any]
"""In compiled code always single precision."""
Matrix = tuple[Number, ...]
"""The upper three rows of a motion."""
Camera = tuple[Number, Number, Number, Number, Number, Number]
"""Focal lengths, principal point, width and height, px."""

NEAR = np.float32(1e-3)  # m, least depth of a moved point
NOTHING = np.float32(1e6)  # m, to what is behind a pixel without depth
NIL = np.float32(0)


class LabelCosts(NamedTuple):
    """Costs of a point in a frame, variances (see `LabelSettings`)."""

    seen_through: Number
    hidden: Number
    hidden_static: Number
    outside: Number
    turned_away: Number
    other_surface: Number
    surface_gap: Number
    """Standard deviations"""
    normal_cosine: Number


class SweepCosts(NamedTuple):
    """Costs of a point in a frame while first steps are searched (see `SweepSettings`)."""

    seen_through: Number
    hidden: Number
    outside: Number
    pixel_sigma: Number
    """px"""
    noise: Number
    """m"""
    empty_distance: Number
    """m"""


def camera_of(intrinsics: Array, depth: Image) -> Camera:
    """What the loops know of the camera of depth images [... H W]."""
    k, (height, width) = intrinsics, depth.shape[-2:]
    numbers = (k[0, 0], k[1, 1], k[0, 2], k[1, 2], width, height)
    return cast(Camera, tuple(np.float32(n) for n in numbers))


def columns(*arrays: Array) -> Image:
    """[C N] in single precision: the columns of arrays [N c] and [N], one after another."""
    return np.ascontiguousarray(np.column_stack(arrays).T, np.float32)


@compiled
def matrix_of(m: Image) -> Matrix:
    """Of a motion [4 4]."""
    return (m[0, 0], m[0, 1], m[0, 2], m[0, 3], m[1, 0], m[1, 1], m[1, 2], m[1, 3],
            m[2, 0], m[2, 1], m[2, 2], m[2, 3])


@compiled
def moved(m: Matrix, x: Number, y: Number, z: Number) -> tuple[Number, Number, Number]:
    """A point under a motion."""
    return (
        m[0] * x + m[1] * y + m[2] * z + m[3],
        m[4] * x + m[5] * y + m[6] * z + m[7],
        m[8] * x + m[9] * y + m[10] * z + m[11],
    )


@compiled
def turned(m: Matrix, x: Number, y: Number, z: Number) -> tuple[Number, Number, Number]:
    """A direction under a motion."""
    return (
        m[0] * x + m[1] * y + m[2] * z,
        m[4] * x + m[5] * y + m[6] * z,
        m[8] * x + m[9] * y + m[10] * z,
    )


class Sight(NamedTuple):
    """Where N moved points meet an image, and what it shows there."""

    x: Image
    y: Image
    z: Image
    """m, at least `NEAR`"""
    u: Image
    v: Image
    """px"""
    pixel: NDArray[np.uint32]
    """In a flat image; the first where the image has none."""
    inside: NDArray[np.bool_]
    depth: Image
    normal_x: Image
    normal_y: Image
    normal_z: Image


@compiled
def sight_of(n: int) -> Sight:
    """Room for one."""
    f = np.float32
    return Sight(
        np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f),
        np.empty(n, np.uint32), np.empty(n, np.bool_),
        np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f),
    )


@compiled
def pixel_of(u: Number, v: Number, camera: Camera) -> tuple[np.uint32, bool]:
    """Where a pixel is in a flat image, and whether the image has it; else of the first."""
    right, bottom = camera[4] - np.float32(1), camera[5] - np.float32(1)
    inside = (u >= 0) & (u <= right) & (v >= 0) & (v <= bottom)  # not if it is no number
    line, column = np.int32(v if inside else NIL), np.int32(u if inside else NIL)
    return np.uint32(line * np.int32(camera[4]) + column), inside


@compiled
def look(
    sight: Sight, m: Matrix, camera: Camera, point: Image, depth: Image, normal: Image
) -> None:
    """Fill in the sight of points [3.. N] in a depth image and its normals, both flat."""
    px, py, pz = point[0], point[1], point[2]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    for i in range(len(px)):
        x, y, z = moved(m, px[i], py[i], pz[i])
        z = max(z, NEAR)
        u, v = fx * x / z + cx, fy * y / z + cy
        sight.x[i], sight.y[i], sight.z[i] = x, y, z
        sight.u[i], sight.v[i] = u, v
        sight.pixel[i], sight.inside[i] = pixel_of(np.rint(u), np.rint(v), camera)
    for i in range(len(px)):
        at = sight.pixel[i]
        sight.depth[i] = depth[at]
        sight.normal_x[i], sight.normal_y[i] = normal[3 * at], normal[3 * at + 1]
        sight.normal_z[i] = normal[3 * at + 2]


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
def add_surface(
    depth: Image, normal: Image, camera: Camera, frame: int, motion: Image, column: Image,
    start: NDArray[np.int64], normal_cosine: Number, matrix: Array, vector: Array,
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
                hit = sight.inside[i] & (d > 0) & (mx * nx + my * ny + mz * nz > normal_cosine)
                residual = nx * (a * d - x) + ny * (b * d - y) + nz * (d - z)
                weight = root_weight(residual, sigma[i]) if hit else NIL
                fill(rows, i, x, y, z, nx, ny, nz, residual, weight)
            total(rows, len(qx), matrix[t, j], vector[t, j])


@compiled
def fill_views(
    depth: Image, normal: Image, camera: Camera, motion: Image, column: Image,
    start: NDArray[np.int64], normal_cosine: Number, row: Image, residual: Image, weight: Image,
) -> None:
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    sight = sight_of(column.shape[1])
    for t in range(len(motion)):
        for j in range(1, motion.shape[1]):
            mine = slice(start[j], start[j + 1])
            m, here = matrix_of(motion[t, j]), column[:, mine]
            look(sight, m, camera, here, depth[t].ravel(), normal[t].ravel())
            qx, qy, qz, sigma = here[3], here[4], here[5], here[6]
            a, r, w = row[t, :, mine], residual[t, mine], weight[t, mine]
            for i in range(len(qx)):
                x, y, z, d = sight.x[i], sight.y[i], sight.z[i], sight.depth[i]
                gx = (np.rint(sight.u[i]) - cx) / fx * d - x
                gy = (np.rint(sight.v[i]) - cy) / fy * d - y
                mx, my, mz = turned(m, qx[i], qy[i], qz[i])
                agree = (mx * sight.normal_x[i] + my * sight.normal_y[i] + mz * sight.normal_z[i]
                         > normal_cosine)
                gap = mx * gx + my * gy + mz * (d - z)
                root = root_weight(gap, sigma[i]) if sight.inside[i] & (d > 0) & agree else NIL
                r[i], w[i] = gap, root * root
                a[0, i], a[1, i], a[2, i] = y * mz - z * my, z * mx - x * mz, x * my - y * mx
                a[3, i], a[4, i], a[5, i] = mx, my, mz


@compiled
def add_flow(
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
                scale = root if hit else NIL
                residual = du[i] - (fx * x / z + cx - sight.u[i])
                weight = scale * root_weight(residual, sigma)
                fill(across, i, x, y, z, fx / z, NIL, -fx * x / (z * z), residual, weight)
                residual = dv[i] - (fy * y / z + cy - sight.v[i])
                weight = scale * root_weight(residual, sigma)
                fill(down, i, x, y, z, NIL, fy / z, -fy * y / (z * z), residual, weight)
            total(across, len(px), matrix[t, j], vector[t, j])
            total(down, len(px), matrix[t, j], vector[t, j])


@compiled
def add_label_costs(
    depth: Image, normal: Image, camera: Camera, frame: int, motion: Image, first: int,
    column: Image, costs: LabelCosts, out: Image,
) -> None:
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    qx, qy, qz, scale = column[3], column[4], column[5], column[6]
    sight = sight_of(len(scale))
    for t in range(len(motion)):
        if t == frame:
            continue
        for j in range(motion.shape[1]):
            m, total = matrix_of(motion[t, j]), out[j]
            look(sight, m, camera, column, depth[t].ravel(), normal[t].ravel())
            hidden = costs.hidden if first + j else costs.hidden_static
            for i in range(len(scale)):
                x, y, z, d = sight.x[i], sight.y[i], sight.z[i], sight.depth[i]
                a, b = (np.rint(sight.u[i]) - cx) / fx, (np.rint(sight.v[i]) - cy) / fy
                nx, ny, nz = sight.normal_x[i], sight.normal_y[i], sight.normal_z[i]
                mx, my, mz = turned(m, qx[i], qy[i], qz[i])
                gap = d - z if d > 0 else NOTHING
                plane = (nx * (a * d - x) + ny * (b * d - y) + nz * (d - z)) / scale[i]
                beyond = costs.seen_through if gap > 0 else hidden
                agree = mx * nx + my * ny + mz * nz > costs.normal_cosine
                cost = min(plane * plane, beyond) if agree else costs.other_surface
                cost = cost if abs(gap) < costs.surface_gap * scale[i] else beyond
                away = mx * x + my * y + mz * z < 0  # its own object hides it
                cost = min(cost, costs.turned_away) if away else cost
                total[i] += cost if sight.inside[i] else costs.outside


@compiled
def judge(
    depth: Image, camera: Camera, motion: Image, column: Image, costs: SweepCosts, out: Image
) -> None:
    for k in range(len(motion)):
        m = matrix_of(motion[k])
        for i in range(column.shape[1]):
            out[k, i] = coarse_cost(depth, camera, m, column, i, costs)


@compiled
def grow(
    depth: Image, camera: Camera, motion: Array, turn: Array, before: Image, column: Image,
    costs: SweepCosts, out: Image,
) -> None:
    both = np.empty((4, 4), np.float32)
    many = column.shape[1]
    for k in range(len(motion)):
        for p in range(len(turn)):
            for a in range(3):
                for b in range(4):
                    s = motion[k, a, 3] if b == 3 else 0.0
                    for c in range(3):
                        s += motion[k, a, c] * turn[p, c, b]
                    both[a, b] = s
            m, total = matrix_of(both), np.float32(0)
            for i in range(many):
                total += min(coarse_cost(depth, camera, m, column, i, costs), before[k, i])
            out[k, p] = total / many


@compiled
def coarse_cost(
    depth: Image, camera: Camera, m: Matrix, column: Image, i: int, costs: SweepCosts
) -> Number:
    fx, fy, cx, cy = camera[:4]
    x, y, z = moved(m, column[0, i], column[1, i], column[2, i])
    z = max(z, NEAR)
    x, y = x / z, y / z
    at, inside = pixel_of(np.rint(fx * x + cx), np.rint(fy * y + cy), camera)
    d = depth[at]
    gap = d - z if d > 0 else costs.empty_distance
    nx, ny, nz = turned(m, column[3, i], column[4, i], column[5, i])
    plane = gap * (nx * x + ny * y + nz) / (costs.pixel_sigma * z / fx + costs.noise)
    cost = min(plane * plane, costs.seen_through if gap > 0 else costs.hidden)
    return cost if inside else costs.outside
