"""Tracks: flow chained from the pixels of key frames to the frames before and after.

Patches fail on plain surfaces and rims; flow knows something of these, too. A step of flow counts
by the texture where it begins, so that a rim counts across only, and by how well the flow back
agrees. The errors of DIS grow as the number of steps, since those of a track go together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..images import VideoEvidence
from ..numerics import Image, compiled
from .settings import RgbSettings

_TRUE_FLOW = (0.02, 1.0, 0.05)
"""`track_sigma`, `track_texture` and `track_share` of the true flow."""


def chain_flow(
    evidence: VideoEvidence, pixel: Array, frame: NDArray[np.int64], frames: int,
    settings: RgbSettings,
) -> tuple[Array, Array]:
    """Return the places [N T 2], px, to which flow carries pixels [N 2] of key frames [N], and
    their information matrices [N T 2 2], 1/px^2: 0 in a pixel's own frame and where its track has
    ended.

    A track ends where it leaves the foreground, and where the flow back disagrees. `frames` is T.
    """
    s, back = settings, evidence.flow_backward
    assert back is not None
    sigma, least, share = (_TRUE_FLOW if evidence.true_flow
                           else (s.track_sigma, s.track_texture, s.track_share))
    return _chain(
        evidence.flow, back, evidence.flow_confidence, evidence.moving, pixel, frame, frames,
        s.track_span, (sigma, least, s.track_return, s.track_limit, share))


@compiled
def _chain(
    flow: Image, back: Image, confidence: Image, moving: NDArray[np.bool_], pixel: Array,
    frame: NDArray[np.int64], frames: int, span: int,
    numbers: tuple[float, float, float, float, float],
) -> tuple[Array, Array]:
    n = len(frame)
    sigma, least, gain, limit, share = numbers
    place, info = np.zeros((n, frames, 2)), np.zeros((n, frames, 2, 2))
    for i in range(n):
        for way in (-1, 1):
            x, y, t = pixel[i, 0], pixel[i, 1], frame[i]
            xx, xy, yy = 0.0, 0.0, 0.0  # sum of the steps' covariances
            for gap in range(1, span + 1):
                to = t + way
                if to < 0 or to >= frames:
                    break
                k = min(t, to)
                there, again = (flow[k], back[k]) if way > 0 else (back[k], flow[k])
                du, dv, spread, ok = _tap(there, moving[t], x, y)
                if not ok:
                    break
                sure = confidence[t, int(np.rint(y)), int(np.rint(x))]
                wxx, wxy, wyy = sure[0] + least, sure[1], sure[2] + least
                x, y = x + du, y + dv
                ru, rv, spread_back, ok = _tap(again, moving[to], x, y)
                away = (du + ru) ** 2 + (dv + rv) ** 2
                if not ok or away > limit * limit:
                    break
                apart = gain * gain * away + spread + spread_back
                scale = sigma * sigma / (wxx * wyy - wxy * wxy)
                xx, xy, yy = xx + scale * wyy + apart, xy - scale * wxy, yy + scale * wxx + apart
                weight = share / (gap * (xx * yy - xy * xy))
                place[i, to, 0], place[i, to, 1] = x, y
                info[i, to, 0, 0], info[i, to, 1, 1] = weight * yy, weight * xx
                info[i, to, 0, 1] = info[i, to, 1, 0] = -weight * xy
                t = to
    return place, info


@compiled
def _tap(
    flow: Image, moving: NDArray[np.bool_], x: float, y: float
) -> tuple[float, float, float, bool]:
    """Flow at (x, y), px, by the foreground pixels around, its variance among them, and whether
    they are most of the four."""
    height, width = moving.shape
    if not (0 <= x < width - 1 and 0 <= y < height - 1):
        return 0.0, 0.0, 0.0, False
    u, v = int(x), int(y)
    total, du, dv, square = 0.0, 0.0, 0.0, 0.0
    for a in range(2):
        for b in range(2):
            if moving[v + a, u + b]:
                w = (1 - abs(y - v - a)) * (1 - abs(x - u - b))
                fu, fv = flow[v + a, u + b, 0], flow[v + a, u + b, 1]
                total, du, dv = total + w, du + w * fu, dv + w * fv
                square += w * (fu * fu + fv * fv)
    if total < 0.5:
        return 0.0, 0.0, 0.0, False
    du, dv = du / total, dv / total
    return du, dv, max(0.0, square / total - du * du - dv * dv), True
