"""Compiled loops of bundle adjustment without depth: normal equations, and planes of points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import compiled


@compiled
def accumulate(
    ray: Array, inverse_depth: Array, label: NDArray[np.int64], key: NDArray[np.int64],
    relative: Array, focal: float, center: Array, flow: Array, flow_info: Array, place: Array,
    place_info: Array, scale: float,
) -> tuple[Array, Array, Array, Array, Array]:
    """Accumulate the normal equations of N points over T frames.

    ray [N 3] (z = 1), key [N] index into `relative` [K T P 4 4] (frame from key frame);
    flow [N T-1 2] px at the point's place in frame t, flow_info [N T-1 2 2]; place [N T 2] px in
    frame t, place_info [N T 2 2]. Residuals are weighted by Geman and McClure's robust weight at
    `scale` standard deviations.

    Returns matrix [K P T 12 12] (twists of t and t + 1), b [K P T 12], c [N T 12] (twists by
    depth), h [N], g [N].
    """
    n, frames = len(ray), relative.shape[1]
    keys, parts = relative.shape[0], relative.shape[2]
    matrix, b = np.zeros((keys, parts, frames, 12, 12)), np.zeros((keys, parts, frames, 12))
    c, h, g = np.zeros((n, frames, 12)), np.zeros(n), np.zeros(n)
    slope, by_depth = np.zeros((frames, 2, 6)), np.zeros((frames, 2))
    at, bad = np.zeros((frames, 2)), np.zeros(frames)
    row, r, d = np.zeros((2, 12)), np.zeros(2), np.zeros(2)
    for i in range(n):
        k, p = key[i], label[i]
        for t in range(frames):
            bad[t] = _linearize(relative[k, t, p], ray[i], inverse_depth[i], focal, center,
                                at[t], by_depth[t], slope[t])
        for t in range(frames - 1):
            w = flow_info[i, t]
            if w[0, 0] + w[1, 1] <= 0 or bad[t] + bad[t + 1] > 0:
                continue
            for a in range(2):
                r[a] = flow[i, t, a] - (at[t + 1, a] - at[t, a])
                d[a] = by_depth[t + 1, a] - by_depth[t, a]
                for m in range(6):
                    row[a, m], row[a, 6 + m] = -slope[t, a, m], slope[t + 1, a, m]
            dh, dg = _add_residual(row, 12, r, d, w, scale, matrix[k, p, t], b[k, p, t], c[i, t])
            h[i], g[i] = h[i] + dh, g[i] + dg
        for t in range(frames):
            w = place_info[i, t]
            if w[0, 0] + w[1, 1] <= 0 or bad[t] > 0:
                continue
            for a in range(2):
                r[a], d[a] = place[i, t, a] - at[t, a], by_depth[t, a]
            dh, dg = _add_residual(
                slope[t], 6, r, d, w, scale, matrix[k, p, t], b[k, p, t], c[i, t])
            h[i], g[i] = h[i] + dh, g[i] + dg
    for k in range(keys):
        for p in range(parts):
            for t in range(frames):
                for m in range(12):
                    for l in range(m):
                        matrix[k, p, t, l, m] = matrix[k, p, t, m, l]
    return matrix, b, c, h, g


@compiled
def _linearize(
    motion: Array, ray: Array, q: float, focal: float, center: Array, at: Array, by_depth: Array,
    slope: Array,
) -> float:
    """Write a point's place [2] under a motion, px, its derivative [2] by inverse depth, and that
    [2 6] by a twist of its part; return 1 where the point is behind the camera."""
    # scaled point: (R ray + q T), depth of 1/q
    x0 = motion[0, 0] * ray[0] + motion[0, 1] * ray[1] + motion[0, 2] * ray[2]
    y0 = motion[1, 0] * ray[0] + motion[1, 1] * ray[1] + motion[1, 2] * ray[2]
    z0 = motion[2, 0] * ray[0] + motion[2, 1] * ray[1] + motion[2, 2] * ray[2]
    x, y, z = x0 + q * motion[0, 3], y0 + q * motion[1, 3], z0 + q * motion[2, 3]
    bad = 1.0 if z < 0.05 else 0.0
    z = max(z, 0.05)
    u, v = x / z, y / z
    at[0], at[1] = focal * u + center[0], focal * v + center[1]
    by_depth[0] = focal * (motion[0, 3] - u * motion[2, 3]) / z
    by_depth[1] = focal * (motion[1, 3] - v * motion[2, 3]) / z
    # twist on the point (x, y, z) / q
    qz = q / z
    slope[0, 0], slope[0, 1], slope[0, 2] = -focal * u * v, focal * (1 + u * u), -focal * v
    slope[1, 0], slope[1, 1], slope[1, 2] = -focal * (1 + v * v), focal * u * v, focal * u
    slope[0, 3], slope[0, 4], slope[0, 5] = focal * qz, 0.0, -focal * u * qz
    slope[1, 3], slope[1, 4], slope[1, 5] = 0.0, focal * qz, -focal * v * qz
    return bad


@compiled
def _add_residual(
    row: Array, size: int, r: Array, d: Array, w: Array, scale: float, matrix: Array, b: Array,
    c: Array,
) -> tuple[float, float]:
    """Add a residual r [2] with information w [2 2], its derivatives row [2 size] by twists and
    d [2] by depth; return the terms of the depth's own equation."""
    w00, w01, w11 = w[0, 0], w[0, 1], w[1, 1]
    e = (w00 * r[0] * r[0] + 2 * w01 * r[0] * r[1] + w11 * r[1] * r[1]) / (scale * scale)
    robust = 1.0 / ((1.0 + e) * (1.0 + e))
    w00, w01, w11 = w00 * robust, w01 * robust, w11 * robust
    a0, a1 = w00 * r[0] + w01 * r[1], w01 * r[0] + w11 * r[1]
    for m in range(size):
        s0 = w00 * row[0, m] + w01 * row[1, m]
        s1 = w01 * row[0, m] + w11 * row[1, m]
        b[m] += a0 * row[0, m] + a1 * row[1, m]
        c[m] += s0 * d[0] + s1 * d[1]
        for l in range(m + 1):
            matrix[m, l] += s0 * row[0, l] + s1 * row[1, l]
    return (w00 * d[0] * d[0] + 2 * w01 * d[0] * d[1] + w11 * d[1] * d[1], a0 * d[0] + a1 * d[1])


@compiled
def fit_slopes(
    first: NDArray[np.signedinteger[Any]], neighbor: NDArray[np.signedinteger[Any]],
    label: NDArray[np.int64], value: Array, prior: float,
) -> Array:
    """Return the slopes [N 2] of planes q(x, y) that are fitted to the points of one label among
    the neighbors of each point and theirs.

    value [N 3] (x, y, q); point i has the neighbors neighbor[first[i]:first[i + 1]]; `prior` is
    added to the sums of squares of x and y.
    """
    out, seen = np.zeros((len(label), 2)), np.full(len(label), -1)
    for i in range(len(label)):
        count, x, y, q = 0, 0.0, 0.0, 0.0
        xx, xy, yy, xq, yq = 0.0, 0.0, 0.0, 0.0, 0.0
        for a in range(first[i], first[i + 1]):
            for b in range(first[neighbor[a]], first[neighbor[a] + 1]):
                j = neighbor[b]
                if seen[j] == i or label[j] != label[i]:
                    continue
                seen[j] = i
                u, v = value[j, 0] - value[i, 0], value[j, 1] - value[i, 1]
                w = value[j, 2] - value[i, 2]
                count, x, y, q = count + 1, x + u, y + v, q + w
                xx, xy, yy = xx + u * u, xy + u * v, yy + v * v
                xq, yq = xq + u * w, yq + v * w
        n = max(1, count)
        xx, xy, yy = xx - x * x / n + prior, xy - x * y / n, yy - y * y / n + prior
        xq, yq = xq - x * q / n, yq - y * q / n
        size = xx * yy - xy * xy
        out[i, 0], out[i, 1] = (yy * xq - xy * yq) / size, (xx * yq - xy * xq) / size
    return out
