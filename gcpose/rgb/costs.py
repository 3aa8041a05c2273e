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

from ...errors import MethodError
from ...robots.geometry import Array
from ..images import VideoEvidence
from ..numerics import Image, compiled
from .settings import RgbSettings

_PATCH_ITERATIONS = 3
_LANES = 16  # numbers in the widest registers of processors; loops over frames are multiples of it


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


def flow_records(evidence: VideoEvidence) -> Image:
    """Return [T h w 6] the flow of each pixel to the next frame, px (2), its confidence uu, uv, vv
    (3), and 1 on the foreground, side by side: reading at random places, memory is slow.

    Raises:
        MethodError: If the video is too large (compiled loops address it by 31 bits).
    """
    if 6 * evidence.moving.size >= 2**31:
        raise MethodError(f"what moves covers {evidence.moving.size / 1e6:.0f} million pixels in "
                          "all frames, and gcpose on rgb takes up to 357; use smaller images")
    out = np.zeros((*evidence.moving.shape, 6), np.float32)
    out[:-1, ..., :2], out[..., 5] = evidence.flow, evidence.moving
    out[..., 2:5] = evidence.flow_confidence
    return out


def flow_costs(
    rays: MovedRays, expected: Array, start: Array, records: Image, iterations: int,
    settings: RgbSettings,
) -> tuple[Array, Array]:
    """Return the cost [N J] per frame of each part by flow, and the inverse depth [N J] with it.

    The depth is found in a number of iterations from start [N J], with a prior about the expected
    inverse depth [N]. A part that moves a foreground pixel to where the background is seen is an
    outlier. See `flow_records` for records [T h w 6].
    """
    s = settings
    keys, frames, parts = rays.motion.shape[:3]
    wide = frames if frames <= _LANES // 2 else (frames - 2) // _LANES * _LANES + _LANES + 1
    motion = np.zeros((keys, parts - 1, 12, wide), np.float32)
    rows = rays.motion[:, :, 1:, :3].reshape(keys, frames, parts - 1, 12)
    motion[..., :frames] = np.moveaxis(rows, 1, 3)
    height, width = records.shape[1:3]
    limit = s.outlier_width * s.outlier_width
    costs = np.array([limit, limit * s.background_cost, s.flow_sigma**2, s.flow_rate**2])
    return _flow_costs(
        rays.ray, rays.key, expected, start, motion, frames,
        tuple(np.array([*rays.camera, width, height], np.float32)), records.reshape(-1),
        iterations, tuple(costs.astype(np.float32)), _depth_prior(s.depth_sigma, s),
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


# Costs by flow are computed in single precision and without branches, for all frames of a point at
# once: the loops over frames are compiled to instructions for several frames.


@compiled
def _flow_costs(
    ray: Array, key: NDArray[np.int64], expected: Array, start: Array, motion: Image, frames: int,
    camera: tuple[np.float32, ...], records: NDArray[np.float32], iterations: int,
    costs: tuple[np.float32, ...], prior: tuple[float, float, float, float],
) -> tuple[Array, Array]:
    """See `flow_costs`; motion [K J 12 W] has three rows for each of W >= T frames."""
    n, parts, wide = len(ray), motion.shape[1], motion.shape[3]
    cost, depth = np.zeros((n, parts)), np.ones((n, parts))
    far, at = np.empty((3, wide), np.float32), np.empty((4, wide), np.float32)
    record, seen = np.empty(wide, np.int32), np.empty(wide, np.float32)
    sigma, most, low, high = prior
    stiff = 1.0 / (sigma * sigma)
    for i in range(n):
        a, b = np.float32(ray[i, 0]), np.float32(ray[i, 1])
        for p in range(parts):
            m = motion[key[i], p]
            for t in range(wide):
                far[0, t] = m[0, t] * a + m[1, t] * b + m[2, t]
                far[1, t] = m[4, t] * a + m[5, t] * b + m[6, t]
                far[2, t] = m[8, t] * a + m[9, t] * b + m[10, t]
            q, total, count = start[i, p], 0.0, 0.0
            for step in range(iterations + 1):
                _project_frames(m, far, np.float32(q), frames, camera, at, record, seen)
                total, count, g, h = _add_flow(at, record, seen, frames, records, costs)
                g, h = g + (expected[i] - q) * stiff, h + stiff
                if step < iterations:
                    q = min(high, max(low, q + min(most, max(-most, g / h))))
            cost[i, p] = total / max(1.0, count)
            depth[i, p] = q
    return cost, depth


@compiled
def _project_frames(
    m: Image, far: Image, q: np.float32, frames: int, camera: tuple[np.float32, ...], at: Image,
    record: NDArray[np.int32], seen: NDArray[np.float32],
) -> None:
    """Write the place of a point in each frame, px, and its derivative by the inverse depth
    (rows of at [4 W]), where its record begins, and 1 where the image has it, else 0."""
    focal, cu, cv, width, height = camera
    near, half, zero, one = np.float32(0.05), np.float32(0.5), np.float32(0), np.float32(1)
    columns, rows = np.int32(width), np.int32(height)
    for t in range(len(seen)):
        z = far[2, t] + q * m[11, t]
        scale = one / (z if z > near else near)
        x, y = (far[0, t] + q * m[3, t]) * scale, (far[1, t] + q * m[7, t]) * scale
        u, v = focal * x + cu, focal * y + cv
        at[0, t], at[1, t] = u, v
        at[2, t] = focal * scale * (m[3, t] - x * m[11, t])
        at[3, t] = focal * scale * (m[7, t] - y * m[11, t])
        u, v = u + half, v + half
        inside = (u > zero) & (u < width) & (v > zero) & (v < height) & (t < frames)
        seen[t] = one if inside else zero
        place = (np.int32(t) * rows + np.int32(v)) * columns + np.int32(u)
        record[t] = 6 * place if inside else np.int32(0)


@compiled
def _add_flow(
    at: Image, record: NDArray[np.int32], seen: NDArray[np.float32], frames: int,
    records: NDArray[np.float32], costs: tuple[np.float32, ...],
) -> tuple[float, float, float, float]:
    """Cost of a point over all frames, frames that show it, and its gradient and curvature by the
    inverse depth."""
    limit, background, square, rate = costs
    zero, two = np.float32(0), np.float32(2)
    total, count, g, h = zero, zero, zero, zero
    last = frames - 1
    for t in range(len(seen) - 1):
        k = np.uint32(record[t])
        fu, fv, here = records[k], records[k + np.uint32(1)], seen[t]
        moving = here * records[k + np.uint32(5)]
        s = (moving if t < last else zero) / (square + rate * (fu * fu + fv * fv))
        wuu, wuv = s * records[k + np.uint32(2)], s * records[k + np.uint32(3)]
        wvv = s * records[k + np.uint32(4)]
        ru, rv = fu - (at[0, t + 1] - at[0, t]), fv - (at[1, t + 1] - at[1, t])
        bu, bv = at[2, t + 1] - at[2, t], at[3, t + 1] - at[3, t]
        au, av = wuu * ru + wuv * rv, wuv * ru + wvv * rv
        e = au * ru + av * rv
        share = limit / (limit + e)
        total += e * share + background * (here - moving)
        count += here
        share = share * share
        g += share * (au * bu + av * bv)
        h += share * (wuu * bu * bu + two * wuv * bu * bv + wvv * bv * bv)
    if len(seen) == frames:  # the last frame has no flow
        here = seen[last]
        moving = here * records[np.uint32(record[last]) + np.uint32(5)]
        total += background * (here - moving)
        count += here
    return float(total), float(count), float(g), float(h)


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
