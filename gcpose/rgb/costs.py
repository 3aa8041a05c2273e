"""What speaks for a pixel's being on a part (Sec. 3.2, E-step): costs without depth.

The paper's residual is the epipolar loss between two frames. Here it is what the flow differs by
from the motion of a point on each part, over all frames, and how far patches were found from where
that motion takes them, with the point's depth chosen as suits that part best.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image, compiled

FLOW_SIGMA = 0.5  # px
FLOW_RATE = 0.05  # and of the flow's length
_WIDTH = 3.0  # standard deviations beyond which flow, or a patch, is simply wrong
_SEEN_THROUGH = 1.5  # cost of a place where only background is seen, of a wrong flow's
_SPREAD = 0.3  # standard deviation of inverse depths about their mean
_OFF = 0.1  # and about what flow and neighbours say


@compiled
def projected(
    motion: Array, ray: Array, inverse_depth: float, focal: float, cu: float, cv: float
) -> tuple[float, float, float, float]:
    """Where a point is under a motion [4 4], px, and how that changes with its inverse depth."""
    a, b, q, m = ray[0], ray[1], inverse_depth, motion
    x = m[0, 0] * a + m[0, 1] * b + m[0, 2] + q * m[0, 3]
    y = m[1, 0] * a + m[1, 1] * b + m[1, 2] + q * m[1, 3]
    z = max(0.05, m[2, 0] * a + m[2, 1] * b + m[2, 2] + q * m[2, 3])
    return (focal * x / z + cu, focal * y / z + cv,
            focal * (m[0, 3] - x / z * m[2, 3]) / z, focal * (m[1, 3] - y / z * m[2, 3]) / z)


@compiled
def flow_costs(
    ray: Array, key: NDArray[np.int64], start: Array, relative: Array, focal: float, cu: float,
    cv: float, flow: Image, hold: Image, moving: NDArray[np.bool_], steps: int,
) -> tuple[Array, Array]:  # fmt: skip
    """[N J] cost a frame of each part, and [N J] the inverse depth that goes with it.

    ray [N 3], key [N] index into `relative` [K T J+1 4 4]; flow [T-1 H W 2] px, hold [T H W 3].
    The depth is found in `steps` steps from start [N J]. A part that takes a foreground pixel to
    where the background is seen is wrong.
    """
    n, parts, last = len(ray), relative.shape[2] - 1, relative.shape[1] - 1
    height, width = moving.shape[1:]
    cost, depth = np.zeros((n, parts)), np.ones((n, parts))
    limit = _WIDTH * _WIDTH
    for i in range(n):
        for p in range(1, parts + 1):
            q = start[i, p - 1]
            total, count = 0.0, 0
            for step in range(steps + 1):
                h, g = 1.0 / (_SPREAD * _SPREAD), (1.0 - q) / (_SPREAD * _SPREAD)
                total, count = 0.0, 0
                u0, v0, du0, dv0, ok0 = 0.0, 0.0, 0.0, 0.0, False
                fu, fv, wuu, wuv, wvv = 0.0, 0.0, 0.0, 0.0, 0.0
                for t in range(last + 1):
                    u, v, du, dv = projected(relative[key[i], t, p], ray[i], q, focal, cu, cv)
                    if t > 0 and ok0:
                        ru, rv = fu - (u - u0), fv - (v - v0)
                        e = wuu * ru * ru + 2 * wuv * ru * rv + wvv * rv * rv
                        robust = 1.0 / (1.0 + e / limit) ** 2
                        total += limit * e / (limit + e)
                        au, av = wuu * ru + wuv * rv, wuv * ru + wvv * rv
                        bu, bv = du - du0, dv - dv0
                        g += robust * (au * bu + av * bv)
                        h += robust * (wuu * bu * bu + 2 * wuv * bu * bv + wvv * bv * bv)
                    ok0 = -0.5 < u < width - 0.5 and -0.5 < v < height - 0.5
                    if ok0:
                        iu, iv = int(np.rint(u)), int(np.rint(v))
                        count += 1
                        if not moving[t, iv, iu]:
                            total += _SEEN_THROUGH * limit
                            ok0 = False
                        elif t < last:
                            fu, fv = flow[t, iv, iu, 0], flow[t, iv, iu, 1]
                            s = 1.0 / (FLOW_SIGMA**2 + FLOW_RATE**2 * (fu * fu + fv * fv))
                            wuu, wuv = s * hold[t, iv, iu, 0], s * hold[t, iv, iu, 1]
                            wvv = s * hold[t, iv, iu, 2]
                    u0, v0, du0, dv0 = u, v, du, dv
                if step < steps:
                    q = min(2.5, max(0.4, q + min(0.1, max(-0.1, g / h))))
            cost[i, p - 1] = total / max(1, count)
            depth[i, p - 1] = q
    return cost, depth


@compiled
def patch_costs(
    ray: Array, key: NDArray[np.int64], start: Array, relative: Array, focal: float, cu: float,
    cv: float, spot: Array, information: Array,
) -> Array:  # fmt: skip
    """[N J] cost of each part, a mean over the frames where patches [N T 2] px were found.

    As `flow_costs`, with depths near start [N J]; information [N T 2 2] is 0 where none was found.
    """
    n, parts, frames = len(ray), relative.shape[2] - 1, relative.shape[1]
    cost = np.zeros((n, parts))
    limit = _WIDTH * _WIDTH
    for i in range(n):
        for p in range(1, parts + 1):
            q = start[i, p - 1]
            total, count = 0.0, 0
            for step in range(4):
                h, g = 1.0 / (_OFF * _OFF), (start[i, p - 1] - q) / (_OFF * _OFF)
                total, count = 0.0, 0
                for t in range(frames):
                    w00, w01 = information[i, t, 0, 0], information[i, t, 0, 1]
                    w11 = information[i, t, 1, 1]
                    if w00 + w11 <= 0:
                        continue
                    u, v, du, dv = projected(relative[key[i], t, p], ray[i], q, focal, cu, cv)
                    ru, rv = spot[i, t, 0] - u, spot[i, t, 1] - v
                    e = w00 * ru * ru + 2 * w01 * ru * rv + w11 * rv * rv
                    robust = 1.0 / (1.0 + e / limit) ** 2
                    total += limit * e / (limit + e)
                    count += 1
                    au, av = w00 * du + w01 * dv, w01 * du + w11 * dv
                    g += robust * (au * ru + av * rv)
                    h += robust * (au * du + av * dv)
                if step < 3:
                    q = min(2.5, max(0.4, q + min(0.1, max(-0.1, g / h))))
            cost[i, p - 1] = total / max(1, count)
    return cost
