"""Normal equations of the bundle adjustment without depth, as machine code (see compiled.py)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import compiled


@compiled
def accumulate(
    ray: Array, inverse_depth: Array, label: NDArray[np.int64], key: NDArray[np.int64],
    relative: Array, focal: float, centre: Array, step_obs: Array, step_info: Array,
    spot_obs: Array, spot_info: Array, scale: float,
) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
    """Normal equations of N points over T frames.

    ray [N 3] (z = 1), key [N] index into `relative` [K T P 4 4] (frame from key frame).
    step_obs [N T-1 2] px flow at the point's place in frame t, step_info [N T-1 2 2];
    spot_obs [N T 2] px place in frame t, spot_info [N T 2 2].
    Returns matrix [K P T 12 12] (twists of t and t + 1), b [K P T 12], c [N T 12] (twists by
    depth), h [N], g [N].
    """
    n, frames = len(ray), relative.shape[1]
    keys, parts = relative.shape[0], relative.shape[2]
    matrix = np.zeros((keys, parts, frames, 12, 12))
    b = np.zeros((keys, parts, frames, 12))
    c = np.zeros((n, frames, 12))
    h = np.zeros(n)
    g = np.zeros(n)
    slope = np.zeros((frames, 2, 6))
    by_depth = np.zeros((frames, 2))
    at = np.zeros((frames, 2))
    bad = np.zeros(frames)
    row = np.zeros((2, 12))
    for i in range(n):
        k, p = key[i], label[i]
        q = inverse_depth[i]
        for t in range(frames):
            motion = relative[k, t, p]
            # scaled point: (R ray + q T), depth of 1/q
            x0 = motion[0, 0] * ray[i, 0] + motion[0, 1] * ray[i, 1] + motion[0, 2] * ray[i, 2]
            y0 = motion[1, 0] * ray[i, 0] + motion[1, 1] * ray[i, 1] + motion[1, 2] * ray[i, 2]
            z0 = motion[2, 0] * ray[i, 0] + motion[2, 1] * ray[i, 1] + motion[2, 2] * ray[i, 2]
            x, y, z = x0 + q * motion[0, 3], y0 + q * motion[1, 3], z0 + q * motion[2, 3]
            bad[t] = 1.0 if z < 0.05 else 0.0
            z = max(z, 0.05)
            u, v = x / z, y / z
            at[t, 0], at[t, 1] = focal * u + centre[0], focal * v + centre[1]
            by_depth[t, 0] = focal * (motion[0, 3] - u * motion[2, 3]) / z
            by_depth[t, 1] = focal * (motion[1, 3] - v * motion[2, 3]) / z
            # twist on the point (x, y, z) / q
            qz = q / z
            slope[t, 0, 0], slope[t, 0, 1] = -focal * u * v, focal * (1 + u * u)
            slope[t, 0, 2] = -focal * v
            slope[t, 1, 0], slope[t, 1, 1] = -focal * (1 + v * v), focal * u * v
            slope[t, 1, 2] = focal * u
            slope[t, 0, 3], slope[t, 0, 4], slope[t, 0, 5] = focal * qz, 0.0, -focal * u * qz
            slope[t, 1, 3], slope[t, 1, 4], slope[t, 1, 5] = 0.0, focal * qz, -focal * v * qz
        for kind in range(2):
            for t in range(frames - 1 if kind == 0 else frames):
                if kind == 0:
                    w00, w01 = step_info[i, t, 0, 0], step_info[i, t, 0, 1]
                    w11 = step_info[i, t, 1, 1]
                    if w00 + w11 <= 0 or bad[t] + bad[t + 1] > 0:
                        continue
                    r0 = step_obs[i, t, 0] - (at[t + 1, 0] - at[t, 0])
                    r1 = step_obs[i, t, 1] - (at[t + 1, 1] - at[t, 1])
                    d0 = by_depth[t + 1, 0] - by_depth[t, 0]
                    d1 = by_depth[t + 1, 1] - by_depth[t, 1]
                else:
                    w00, w01 = spot_info[i, t, 0, 0], spot_info[i, t, 0, 1]
                    w11 = spot_info[i, t, 1, 1]
                    if w00 + w11 <= 0 or bad[t] > 0:
                        continue
                    r0 = spot_obs[i, t, 0] - at[t, 0]
                    r1 = spot_obs[i, t, 1] - at[t, 1]
                    d0, d1 = by_depth[t, 0], by_depth[t, 1]
                e = (w00 * r0 * r0 + 2 * w01 * r0 * r1 + w11 * r1 * r1) / (scale * scale)
                robust = 1.0 / ((1.0 + e) * (1.0 + e))
                w00, w01, w11 = w00 * robust, w01 * robust, w11 * robust
                a0, a1 = w00 * r0 + w01 * r1, w01 * r0 + w11 * r1
                h[i] += w00 * d0 * d0 + 2 * w01 * d0 * d1 + w11 * d1 * d1
                g[i] += a0 * d0 + a1 * d1
                size = 12 if kind == 0 else 6
                for m in range(6):
                    if kind == 0:
                        row[0, m], row[1, m] = -slope[t, 0, m], -slope[t, 1, m]
                        row[0, 6 + m], row[1, 6 + m] = slope[t + 1, 0, m], slope[t + 1, 1, m]
                    else:
                        row[0, m], row[1, m] = slope[t, 0, m], slope[t, 1, m]
                for m in range(size):
                    s0 = w00 * row[0, m] + w01 * row[1, m]
                    s1 = w01 * row[0, m] + w11 * row[1, m]
                    b[k, p, t, m] += a0 * row[0, m] + a1 * row[1, m]
                    c[i, t, m] += s0 * d0 + s1 * d1
                    for l in range(m + 1):
                        matrix[k, p, t, m, l] += s0 * row[0, l] + s1 * row[1, l]
    for k in range(keys):
        for p in range(parts):
            for t in range(frames):
                for m in range(12):
                    for l in range(m):
                        matrix[k, p, t, l, m] = matrix[k, p, t, m, l]
    return matrix, b, c, h, g
