"""What the footage says of a hypothesis' points: flow where they are, and patches found again.

Flow is dense and drifts; patches are few, and tell where a point is for good.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import Articulation
from ..images import CONTRAST, Footage, match
from .costs import FLOW_RATE, FLOW_SIGMA
from .points import Rays, places, warps

REACH = 3.0  # px, from where a patch is expected
SPAN = 3  # frames from a patch's own within which it is looked for
_SHARE = 0.2  # of its pixels, of those whose flow errs independently
_RADIUS = 3  # px, of a patch: larger ones hold more than one part
_MODEL, _MODEL_RATE = 0.1, 0.02  # px, what a patch errs by, and more with each frame
_EVEN = 2.0  # grey levels a pixel: weaker gradients are shading
_WRONG, _LOST = 9.0, 4.0  # cost of a patch that is elsewhere, and of one that is not found


def observed(seen: Footage, state: Articulation, rays: Rays) -> Rays:
    """The points with the flow at their places."""
    at = places(state, rays, seen.intrinsics)[:, :-1]
    n, last = at.shape[:2]
    t = np.arange(last)[None]
    u, v, good = moving_at(seen, at, t)
    step = seen.flow[t, v, u].astype(np.float64)
    hold = seen.hold[t, v, u].astype(np.float64)
    weight = _SHARE * good / (FLOW_SIGMA**2 + FLOW_RATE**2 * (step**2).sum(axis=2))
    information = hold[..., [0, 1, 1, 2]].reshape(n, last, 2, 2)
    return replace(
        rays, step=step, step_information=information * weight[..., None, None],
        spot=np.zeros((n, last + 1, 2)), spot_information=np.zeros((n, last + 1, 2, 2)),
    )  # fmt: skip


def matched(
    seen: Footage, state: Articulation, rays: Rays, reach: float = REACH, span: int = SPAN
) -> Rays:
    """The points with the places where the patches around them are found in the frames near their
    own, within `reach` px of where the hypothesis expects them."""
    at, warp = places(state, rays, seen.intrinsics), warps(state, rays)
    n, frames = at.shape[:2]
    wanted = nearby(rays, frames, span) & moving_at(seen, at, np.arange(frames)[None])[2]
    found, information = match(
        seen.look, at[np.arange(n), rays.frame], rays.frame, at, warp, wanted, _RADIUS, reach,
        _MODEL, _MODEL_RATE, CONTRAST, _EVEN,
    )  # fmt: skip
    return replace(
        rays, step=np.zeros((n, frames - 1, 2)), step_information=np.zeros((n, frames - 1, 2, 2)),
        spot=found, spot_information=information,
    )  # fmt: skip


def misfit(seen: Footage, state: Articulation, rays: Rays) -> float:
    """Mean cost of patches, those that are not found included."""
    rays = matched(seen, state, rays)
    away = rays.spot - places(state, rays, seen.intrinsics)
    square = np.einsum("nti,ntij,ntj->nt", away, rays.spot_information, away)
    found = rays.spot_information[..., 0, 0] + rays.spot_information[..., 1, 1] > 0
    cost = np.where(found, _WRONG * square / (_WRONG + square), _LOST)
    return float(cost[nearby(rays, cost.shape[1], SPAN)].mean())


def nearby(rays: Rays, frames: int, span: int) -> NDArray[np.bool_]:
    """[N T] whether a frame is one of the `span` on either side of the point's own."""
    gap = np.abs(np.arange(frames)[None] - rays.frame[:, None])
    return (gap > 0) & (gap <= span)


def moving_at(
    seen: Footage, at: Array, frame: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """[N T] columns and lines of places [N T 2] px in frames [1 T], 0 outside of the image; and
    whether something that moves is seen there."""
    height, width = seen.moving.shape[1:]
    pixel = np.rint(np.clip(at, -2, 1e4)).astype(np.int64)
    u, v = pixel[..., 0], pixel[..., 1]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    return u, v, inside & seen.moving[frame, v, u]
