"""Tracks of pixels of key frames: flow chained to the frames before and after, with covariances.

A step counts by the texture where it begins, so that a rim counts across only, and by how well the
flow back agrees. Errors add up along a track.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..images import VideoEvidence
from ..numerics import Image, compiled
from .settings import RgbSettings


def chain_flow(
    evidence: VideoEvidence, pixel: Array, frame: NDArray[np.int64], settings: RgbSettings
) -> tuple[Array, Array]:
    """Return the places [N T 2], px, to which flow carries pixels [N 2] of frames [N], and their
    information matrices [N T 2 2], 1/px^2: 0 where a track has ended, and in its own frame.

    A track ends where it leaves the foreground, and where the flow back disagrees.
    """
    s = settings
    return _chain(
        evidence.flow, evidence.flow_backward, evidence.flow_confidence, evidence.moving, pixel,
        frame, s.track_span,
        (s.track_sigma if evidence.flow_confidence is evidence.texture_confidence else s.track_sigma_true, s.track_texture, s.track_return, s.track_limit, s.track_share))


@compiled
def _chain(
    flow: Image, back: Image, confidence: Image, moving: NDArray[np.bool_], pixel: Array,
    frame: NDArray[np.int64], span: int, numbers: tuple[float, float, float, float, float],
) -> tuple[Array, Array]:
    n, frames = len(frame), len(moving)
    height, width = moving.shape[1:]
    sigma, least, gain, limit, share = numbers
    place, info = np.zeros((n, frames, 2)), np.zeros((n, frames, 2, 2))
    for i in range(n):
        for way in (-1, 1):
            x, y, t = pixel[i, 0], pixel[i, 1], frame[i]
            cxx, cxy, cyy = 0.0, 0.0, 0.0
            for gap in range(1, span + 1):
                to = t + way
                if to < 0 or to >= frames:
                    break
                step = min(t, to)
                there, again = (flow, back) if way > 0 else (back, flow)
                fx, fy, spread, ok = _tap(there[step], moving[t], x, y)
                u, v = int(np.rint(x)), int(np.rint(y))
                wxx, wxy = confidence[t, v, u, 0] + least, confidence[t, v, u, 1]
                wyy = confidence[t, v, u, 2] + least
                x, y = x + fx, y + fy
                bx, by, spread_back, seen = _tap(again[step], moving[to], x, y)
                away = (fx + bx) ** 2 + (fy + by) ** 2
                if not (ok and seen) or away > limit * limit:
                    break
                apart = gain * gain * away + spread + spread_back
                variance = sigma * sigma / (wxx * wyy - wxy * wxy)
                cxx += variance * wyy + apart
                cxy -= variance * wxy
                cyy += variance * wxx + apart
                weight = share / (cxx * cyy - cxy * cxy) / gap  # errors go together
                place[i, to, 0], place[i, to, 1] = x, y
                info[i, to, 0, 0], info[i, to, 1, 1] = weight * cyy, weight * cxx
                info[i, to, 0, 1] = info[i, to, 1, 0] = -weight * cxy
                t = to
    return place, info


@compiled
def _tap(
    flow: Image, moving: NDArray[np.bool_], x: float, y: float
) -> tuple[float, float, float, bool]:
    """Flow at (x, y) by the foreground pixels around it, the variance of theirs, and whether
    there are some."""
    height, width = moving.shape
    if not (0 <= x < width - 1 and 0 <= y < height - 1):
        return 0.0, 0.0, 0.0, False
    u, v = int(x), int(y)
    total, fx, fy, square = 0.0, 0.0, 0.0, 0.0
    for a in range(2):
        for b in range(2):
            if moving[v + a, u + b]:
                w = (1 - abs(y - v - a)) * (1 - abs(x - u - b))
                du, dv = flow[v + a, u + b, 0], flow[v + a, u + b, 1]
                total, fx, fy = total + w, fx + w * du, fy + w * dv
                square += w * (du * du + dv * dv)
    if total < 0.5:
        return 0.0, 0.0, 0.0, False
    fx, fy = fx / total, fy / total
    return fx, fy, max(0.0, square / total - fx * fx - fy * fy), True
