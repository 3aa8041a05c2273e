"""Label costs without depth (Sec. 3.2, E-step): how badly each part's motion explains a pixel.

The paper's residual is the epipolar loss between two frames. Here it is the difference of the flow
from the motion of a point on each part, over all frames, and the distance of patches from their
predicted places, at the depth of the point that fits that part best. Residuals count by Geman and
McClure's robust cost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..images import VideoEvidence
from ..numerics import Image, compiled
from .settings import RgbSettings

_PATCH_ITERATIONS = 3


@dataclass(frozen=True)
class MovedRays:
    """N pixels of key frames under the motions of all parts."""

    ray: Array
    """[N 3] at depth 1"""
    key: NDArray[np.int64]
    """[N] index into `motion`"""
    motion: Array
    """[K T J+1 4 4] of each part from each of K key frames to each frame"""
    camera: tuple[float, float, float]
    """Focal length and principal point, px"""


def flow_costs(
    rays: MovedRays, expected: Array, start: Array, evidence: VideoEvidence, iterations: int,
    settings: RgbSettings,
) -> tuple[Array, Array]:
    """Return the cost [N J] per frame of each part by flow, and the inverse depth [N J] with it.

    The depth is found in a number of iterations from start [N J], with a prior about the expected
    inverse depth [N]. A part that moves a foreground
    pixel to where the background is seen is an outlier.
    """
    s = settings
    return _flow_costs(
        rays.ray, rays.key, expected, start, rays.motion, rays.camera, evidence.flow,
        evidence.flow_confidence, evidence.moving, iterations,
        (s.outlier_width * s.outlier_width, s.background_cost, s.flow_sigma, s.flow_rate),
        _depth_prior(s.depth_sigma, s),
    )


def patch_costs(
    rays: MovedRays, start: Array, place: Array, information: Array, settings: RgbSettings
) -> Array:
    """Return the cost [N J] of each part, the mean over the frames where patches were found.

    Depths stay near start [N J]. place [N T 2] px; information [N T 2 2] is 0 where none was found.
    """
    return _patch_costs(
        rays.ray, rays.key, start, rays.motion, rays.camera, place, information,
        settings.outlier_width * settings.outlier_width, _PATCH_ITERATIONS,
        _depth_prior(settings.depth_sigma_patch, settings),
    )


def _depth_prior(sigma: float, settings: RgbSettings) -> tuple[float, float, float, float]:
    """Standard deviation, largest step, least and largest value of inverse depths."""
    return (sigma, settings.max_depth_step, settings.min_inverse_depth, settings.max_inverse_depth)


@compiled
def _project(
    motion: Array, ray: Array, inverse_depth: float, camera: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    """Place of a point under a motion [4 4], px, and its derivative by the inverse depth."""
    focal, cu, cv = camera
    a, b, q, m = ray[0], ray[1], inverse_depth, motion
    x = m[0, 0] * a + m[0, 1] * b + m[0, 2] + q * m[0, 3]
    y = m[1, 0] * a + m[1, 1] * b + m[1, 2] + q * m[1, 3]
    z = max(0.05, m[2, 0] * a + m[2, 1] * b + m[2, 2] + q * m[2, 3])
    return (focal * x / z + cu, focal * y / z + cv,
            focal * (m[0, 3] - x / z * m[2, 3]) / z, focal * (m[1, 3] - y / z * m[2, 3]) / z)


@compiled
def _flow_costs(
    ray: Array, key: NDArray[np.int64], expected: Array, start: Array, relative: Array,
    camera: tuple[float, float, float], flow: Image, confidence: Image, moving: NDArray[np.bool_],
    iterations: int, costs: tuple[float, float, float, float],
    prior: tuple[float, float, float, float],
) -> tuple[Array, Array]:
    n, parts = len(ray), relative.shape[2] - 1
    cost, depth = np.zeros((n, parts)), np.ones((n, parts))
    sigma, most, low, high = prior
    for i in range(n):
        for p in range(1, parts + 1):
            q, total, count = start[i, p - 1], 0.0, 0
            for step in range(iterations + 1):
                g, h = (expected[i] - q) / (sigma * sigma), 1.0 / (sigma * sigma)
                total, count, g, h = _add_flow(relative[key[i], :, p], ray[i], q, camera, flow,
                                               confidence, moving, costs, g, h)
                if step < iterations:
                    q = min(high, max(low, q + min(most, max(-most, g / h))))
            cost[i, p - 1] = total / max(1, count)
            depth[i, p - 1] = q
    return cost, depth


@compiled
def _add_flow(
    motion: Array, ray: Array, q: float, camera: tuple[float, float, float], flow: Image,
    confidence: Image, moving: NDArray[np.bool_], costs: tuple[float, float, float, float],
    g: float, h: float,
) -> tuple[float, int, float, float]:
    """Cost of a point over all frames, frames that show it, and its gradient and curvature by q
    added to g and h."""
    limit, background, sigma, rate = costs
    height, width = moving.shape[1:]
    total, count = 0.0, 0
    u0, v0, du0, dv0, ok0 = 0.0, 0.0, 0.0, 0.0, False
    fu, fv, wuu, wuv, wvv = 0.0, 0.0, 0.0, 0.0, 0.0
    for t in range(len(motion)):
        u, v, du, dv = _project(motion[t], ray, q, camera)
        if ok0:
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
                total += background * limit
                ok0 = False
            elif t < len(flow):
                fu, fv = flow[t, iv, iu, 0], flow[t, iv, iu, 1]
                s = 1.0 / (sigma**2 + rate**2 * (fu * fu + fv * fv))
                wuu, wuv = s * confidence[t, iv, iu, 0], s * confidence[t, iv, iu, 1]
                wvv = s * confidence[t, iv, iu, 2]
        u0, v0, du0, dv0 = u, v, du, dv
    return total, count, g, h


@compiled
def _patch_costs(
    ray: Array, key: NDArray[np.int64], start: Array, relative: Array,
    camera: tuple[float, float, float], place: Array, information: Array, limit: float,
    iterations: int, prior: tuple[float, float, float, float],
) -> Array:
    n, parts, frames = len(ray), relative.shape[2] - 1, relative.shape[1]
    cost = np.zeros((n, parts))
    sigma, most, low, high = prior
    for i in range(n):
        for p in range(1, parts + 1):
            q, total, count = start[i, p - 1], 0.0, 0
            for step in range(iterations + 1):
                h, g = 1.0 / (sigma * sigma), (start[i, p - 1] - q) / (sigma * sigma)
                total, count = 0.0, 0
                for t in range(frames):
                    w00, w01 = information[i, t, 0, 0], information[i, t, 0, 1]
                    w11 = information[i, t, 1, 1]
                    if w00 + w11 <= 0:
                        continue
                    u, v, du, dv = _project(relative[key[i], t, p], ray[i], q, camera)
                    ru, rv = place[i, t, 0] - u, place[i, t, 1] - v
                    e = w00 * ru * ru + 2 * w01 * ru * rv + w11 * rv * rv
                    robust = 1.0 / (1.0 + e / limit) ** 2
                    total += limit * e / (limit + e)
                    count += 1
                    au, av = w00 * du + w01 * dv, w01 * du + w11 * dv
                    g += robust * (au * ru + av * rv)
                    h += robust * (au * du + av * dv)
                if step < iterations:
                    q = min(high, max(low, q + min(most, max(-most, g / h))))
            cost[i, p - 1] = total / max(1, count)
    return cost
