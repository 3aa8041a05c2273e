"""Compiled inner loops of the estimator with depth (see numerics/compilation.py).

Loops over points have no branches and work on single-precision numbers with one array for each
coordinate, so that the compiler vectorizes them. That is most of their gain over NumPy; a
`continue`, or a load with a computed index beside a store, prevents it.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..images import Surfaces
from ..numerics import Image, compiled

Number = float | np.floating[Any]
"""Always of single precision in compiled code."""
FlatMotion = tuple[Number, ...]
"""The upper three rows of a motion [4 4]."""
FlatCamera = tuple[Number, Number, Number, Number, Number, Number]
"""Focal lengths, principal point, width and height, px."""

MIN_DEPTH = np.float32(1e-3)  # m; moved points are put at this depth at least
EMPTY_DISTANCE = np.float32(1e6)  # m; gap behind a point at a pixel without depth
COARSE_EMPTY_DISTANCE = np.float32(10)  # m; the same in a sweep, where it is weighed
ZERO = np.float32(0)


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


def flat_camera(surfaces: Surfaces) -> FlatCamera:
    """Return the camera of depth images in single precision."""
    k, (height, width) = surfaces.intrinsics, surfaces.depth.shape[-2:]
    numbers = (k[0, 0], k[1, 1], k[0, 2], k[1, 2], width, height)
    return cast(FlatCamera, tuple(np.float32(n) for n in numbers))


def columns(*arrays: Array) -> Image:
    """Return [C N] in single precision: the columns of arrays [N c] and [N]."""
    return np.ascontiguousarray(np.column_stack(arrays).T, np.float32)


@compiled
def flat_motion(m: Image) -> FlatMotion:
    """Return the numbers of a motion [4 4]."""
    return (m[0, 0], m[0, 1], m[0, 2], m[0, 3], m[1, 0], m[1, 1], m[1, 2], m[1, 3],
            m[2, 0], m[2, 1], m[2, 2], m[2, 3])


@compiled
def transform_point(
    m: FlatMotion, x: Number, y: Number, z: Number
) -> tuple[Number, Number, Number]:
    """Return a moved point."""
    return (
        m[0] * x + m[1] * y + m[2] * z + m[3],
        m[4] * x + m[5] * y + m[6] * z + m[7],
        m[8] * x + m[9] * y + m[10] * z + m[11],
    )


@compiled
def rotate(m: FlatMotion, x: Number, y: Number, z: Number) -> tuple[Number, Number, Number]:
    """Return a rotated direction."""
    return (
        m[0] * x + m[1] * y + m[2] * z,
        m[4] * x + m[5] * y + m[6] * z,
        m[8] * x + m[9] * y + m[10] * z,
    )


class Lookup(NamedTuple):
    """N moved points, their pixels, and what an image shows there."""

    x: Image
    y: Image
    z: Image
    """m, at least `MIN_DEPTH`"""
    u: Image
    v: Image
    """px"""
    pixel: NDArray[np.uint32]
    """Index in the flat image; 0 outside."""
    inside: NDArray[np.bool_]
    depth: Image
    normal_x: Image
    normal_y: Image
    normal_z: Image


@compiled
def empty_lookup(n: int) -> Lookup:
    """Return an uninitialized lookup of n points."""
    f = np.float32
    return Lookup(
        np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f),
        np.empty(n, np.uint32), np.empty(n, np.bool_),
        np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f),
    )


@compiled
def flat_pixel(u: Number, v: Number, camera: FlatCamera) -> tuple[np.uint32, bool]:
    """Return the index of a pixel in the flat image, and whether it is inside; 0 outside."""
    right, bottom = camera[4] - np.float32(1), camera[5] - np.float32(1)
    inside = (u >= 0) & (u <= right) & (v >= 0) & (v <= bottom)  # False for NaN
    line, column = np.int32(v if inside else ZERO), np.int32(u if inside else ZERO)
    return np.uint32(line * np.int32(camera[4]) + column), inside


@compiled
def look_up_points(
    sight: Lookup, m: FlatMotion, camera: FlatCamera, point: Image, depth: Image, normal: Image
) -> None:
    """Look up moved points [3.. N] in a depth image and its normals, both flat."""
    px, py, pz = point[0], point[1], point[2]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    for i in range(len(px)):
        x, y, z = transform_point(m, px[i], py[i], pz[i])
        z = max(z, MIN_DEPTH)
        u, v = fx * x / z + cx, fy * y / z + cy
        sight.x[i], sight.y[i], sight.z[i] = x, y, z
        sight.u[i], sight.v[i] = u, v
        sight.pixel[i], sight.inside[i] = flat_pixel(np.rint(u), np.rint(v), camera)
    for i in range(len(px)):
        at = sight.pixel[i]
        sight.depth[i] = depth[at]
        sight.normal_x[i], sight.normal_y[i] = normal[3 * at], normal[3 * at + 1]
        sight.normal_z[i] = normal[3 * at + 2]


class WeightedRows(NamedTuple):
    """Residuals and their derivatives to twists, times the square root of their weights."""

    turn_x: Image
    turn_y: Image
    turn_z: Image
    slide_x: Image
    slide_y: Image
    slide_z: Image
    residual: Image


@compiled
def empty_rows(n: int) -> WeightedRows:
    """Return n uninitialized rows."""
    f = np.float32
    return WeightedRows(np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f),
                        np.empty(n, f), np.empty(n, f), np.empty(n, f))


@compiled
def set_row(
    rows: WeightedRows, i: int, x: Number, y: Number, z: Number, a: Number, b: Number, c: Number,
    residual: Number, weight: Number,
) -> None:
    """Set row i: a residual that falls by (a, b, c) per meter that its point (x, y, z) moves."""
    rows.turn_x[i] = weight * (y * c - z * b)
    rows.turn_y[i] = weight * (z * a - x * c)
    rows.turn_z[i] = weight * (x * b - y * a)
    rows.slide_x[i] = weight * a
    rows.slide_y[i] = weight * b
    rows.slide_z[i] = weight * c
    rows.residual[i] = weight * residual


@compiled
def dot(a: Image, b: Image, many: int) -> Number:
    """Return the dot product of the first `many` numbers."""
    out = np.float32(0)
    for i in range(many):
        out += a[i] * b[i]
    return out


@compiled
def add_rows(rows: WeightedRows, many: int, matrix: Array, vector: Array) -> None:
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
    """Return the square root of Geman-McClure's weight by the variance."""
    ratio = residual / sigma
    return np.float32(1) / ((np.float32(1) + ratio * ratio) * sigma)


@compiled
def add_surface(
    depth: Image, normal: Image, camera: FlatCamera, frame: int, motion: Image, column: Image,
    start: NDArray[np.int64], normal_cosine: Number, matrix: Array, vector: Array,
) -> None:
    """Add point-to-plane distances to matrix [T J+1 6 6] and vector [T J+1 6]."""
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    sight, rows = empty_lookup(column.shape[1]), empty_rows(column.shape[1])
    for t in range(len(motion)):
        if t == frame:
            continue
        for j in range(1, motion.shape[1]):
            m, here = flat_motion(motion[t, j]), column[:, start[j] : start[j + 1]]
            look_up_points(sight, m, camera, here, depth[t].ravel(), normal[t].ravel())
            qx, qy, qz, sigma = here[3], here[4], here[5], here[6]
            for i in range(len(qx)):
                x, y, z, d = sight.x[i], sight.y[i], sight.z[i], sight.depth[i]
                a, b = (np.rint(sight.u[i]) - cx) / fx, (np.rint(sight.v[i]) - cy) / fy
                nx, ny, nz = sight.normal_x[i], sight.normal_y[i], sight.normal_z[i]
                mx, my, mz = rotate(m, qx[i], qy[i], qz[i])
                hit = sight.inside[i] & (d > 0) & (mx * nx + my * ny + mz * nz > normal_cosine)
                residual = nx * (a * d - x) + ny * (b * d - y) + nz * (d - z)
                weight = root_weight(residual, sigma[i]) if hit else ZERO
                set_row(rows, i, x, y, z, nx, ny, nz, residual, weight)
            add_rows(rows, len(qx), matrix[t, j], vector[t, j])


@compiled
def fill_plane_rows(
    depth: Image, normal: Image, camera: FlatCamera, motion: Image, column: Image,
    start: NDArray[np.int64], normal_cosine: Number, row: Image, residual: Image, weight: Image,
) -> None:
    """Fill in distances along the points' own normals, their derivatives and weights, by frame."""
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    sight = empty_lookup(column.shape[1])
    for t in range(len(motion)):
        for j in range(1, motion.shape[1]):
            mine = slice(start[j], start[j + 1])
            m, here = flat_motion(motion[t, j]), column[:, mine]
            look_up_points(sight, m, camera, here, depth[t].ravel(), normal[t].ravel())
            qx, qy, qz, sigma = here[3], here[4], here[5], here[6]
            a, r, w = row[t, :, mine], residual[t, mine], weight[t, mine]
            for i in range(len(qx)):
                x, y, z, d = sight.x[i], sight.y[i], sight.z[i], sight.depth[i]
                gx = (np.rint(sight.u[i]) - cx) / fx * d - x
                gy = (np.rint(sight.v[i]) - cy) / fy * d - y
                mx, my, mz = rotate(m, qx[i], qy[i], qz[i])
                agree = (mx * sight.normal_x[i] + my * sight.normal_y[i] + mz * sight.normal_z[i]
                         > normal_cosine)
                gap = mx * gx + my * gy + mz * (d - z)
                root = root_weight(gap, sigma[i]) if sight.inside[i] & (d > 0) & agree else ZERO
                r[i], w[i] = gap, root * root
                a[0, i], a[1, i], a[2, i] = y * mz - z * my, z * mx - x * mz, x * my - y * mx
                a[3, i], a[4, i], a[5, i] = mx, my, mz


@compiled
def add_flow(
    depth: Image, normal: Image, flow: Image, camera: FlatCamera, motion: Image, column: Image,
    start: NDArray[np.int64], reach: Number, sigma: Number, share: Number, matrix: Array,
    vector: Array,
) -> None:
    """Add differences of flow to matrix [T-1 J+1 6 6] and vector [T-1 J+1 6].

    `reach` (m) is the distance from the surface within which flow is of the point.
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    n, root = column.shape[1], np.sqrt(share)
    sight, across, down = empty_lookup(n), empty_rows(n), empty_rows(n)
    du, dv = np.empty(n, np.float32), np.empty(n, np.float32)
    for t in range(len(motion) - 1):
        moves = flow[t].ravel()
        for j in range(1, motion.shape[1]):
            after, here = flat_motion(motion[t + 1, j]), column[:, start[j] : start[j + 1]]
            look_up_points(sight, flat_motion(motion[t, j]), camera, here, depth[t].ravel(),
                 normal[t].ravel())
            px, py, pz = here[0], here[1], here[2]
            for i in range(len(px)):
                du[i], dv[i] = moves[2 * sight.pixel[i]], moves[2 * sight.pixel[i] + 1]
            for i in range(len(px)):
                hit = sight.inside[i] & (abs(sight.depth[i] - sight.z[i]) < reach)
                x, y, z = transform_point(after, px[i], py[i], pz[i])
                z = max(z, MIN_DEPTH)
                scale = root if hit else ZERO
                residual = du[i] - (fx * x / z + cx - sight.u[i])
                weight = scale * root_weight(residual, sigma)
                set_row(across, i, x, y, z, fx / z, ZERO, -fx * x / (z * z), residual, weight)
                residual = dv[i] - (fy * y / z + cy - sight.v[i])
                weight = scale * root_weight(residual, sigma)
                set_row(down, i, x, y, z, ZERO, fy / z, -fy * y / (z * z), residual, weight)
            add_rows(across, len(px), matrix[t, j], vector[t, j])
            add_rows(down, len(px), matrix[t, j], vector[t, j])


@compiled
def add_label_costs(
    depth: Image, normal: Image, camera: FlatCamera, frame: int, motion: Image, first: int,
    column: Image, costs: LabelCosts, out: Image,
) -> None:
    """Add the costs of points under each part to out [P N], summed over frames."""
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    qx, qy, qz, scale = column[3], column[4], column[5], column[6]
    sight = empty_lookup(len(scale))
    for t in range(len(motion)):
        if t == frame:
            continue
        for j in range(motion.shape[1]):
            m, total = flat_motion(motion[t, j]), out[j]
            look_up_points(sight, m, camera, column, depth[t].ravel(), normal[t].ravel())
            hidden = costs.hidden if first + j else costs.hidden_static
            for i in range(len(scale)):
                x, y, z, d = sight.x[i], sight.y[i], sight.z[i], sight.depth[i]
                a, b = (np.rint(sight.u[i]) - cx) / fx, (np.rint(sight.v[i]) - cy) / fy
                nx, ny, nz = sight.normal_x[i], sight.normal_y[i], sight.normal_z[i]
                mx, my, mz = rotate(m, qx[i], qy[i], qz[i])
                gap = d - z if d > 0 else EMPTY_DISTANCE
                plane = (nx * (a * d - x) + ny * (b * d - y) + nz * (d - z)) / scale[i]
                beyond = costs.seen_through if gap > 0 else hidden
                agree = mx * nx + my * ny + mz * nz > costs.normal_cosine
                cost = min(plane * plane, beyond) if agree else costs.other_surface
                cost = cost if abs(gap) < costs.surface_gap * scale[i] else beyond
                away = mx * x + my * y + mz * z < 0  # its own object hides it
                cost = min(cost, costs.turned_away) if away else cost
                total[i] += cost if sight.inside[i] else costs.outside


@compiled
def fill_step_costs(
    depth: Image, camera: FlatCamera, motion: Image, column: Image, costs: SweepCosts, out: Image
) -> None:
    """Fill in costs [M N] of points under motion [M 4 4]."""
    for k in range(len(motion)):
        m = flat_motion(motion[k])
        for i in range(column.shape[1]):
            out[k, i] = coarse_cost(depth, camera, m, column, i, costs)


@compiled
def fill_mean_costs(
    depth: Image, camera: FlatCamera, motion: Array, turn: Array, before: Image, column: Image,
    costs: SweepCosts, out: Image,
) -> None:
    """Fill in mean costs [M P] of chains with costs before [M N] and one more part."""
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
            m, total = flat_motion(both), np.float32(0)
            for i in range(many):
                total += min(coarse_cost(depth, camera, m, column, i, costs), before[k, i])
            out[k, p] = total / many


@compiled
def coarse_cost(
    depth: Image, camera: FlatCamera, m: FlatMotion, column: Image, i: int, costs: SweepCosts
) -> Number:
    """Return the cost of point i in a frame, variances of a coarse grid of steps."""
    fx, fy, cx, cy = camera[:4]
    x, y, z = transform_point(m, column[0, i], column[1, i], column[2, i])
    z = max(z, MIN_DEPTH)
    x, y = x / z, y / z
    at, inside = flat_pixel(np.rint(fx * x + cx), np.rint(fy * y + cy), camera)
    d = depth[at]
    gap = d - z if d > 0 else COARSE_EMPTY_DISTANCE
    nx, ny, nz = rotate(m, column[3, i], column[4, i], column[5, i])
    plane = gap * (nx * x + ny * y + nz) / (costs.pixel_sigma * z / fx + costs.noise)
    cost = min(plane * plane, costs.seen_through if gap > 0 else costs.hidden)
    return cost if inside else costs.outside
