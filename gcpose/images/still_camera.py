"""What a video from a still camera shows without depth: what moves, where to, and how surely."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image
from .depth import Depth
from .flow import for_cuts_of
from .flow_types import Flow

CONTRAST = 60.0
"""Of the outline's channel, in grey levels."""
_CHANGED = 3  # of 255: less is noise
_UNLIKE = 6  # of 255: more is not the background
_SPECK, _GAP, _STILL_GAP = 150, 300, 1500  # px: smaller foreground, or gaps in it, are none
_MARGIN = 24  # px around what moves
_TEXTURE = 60.0  # squared grey levels a pixel: gradients that flow can hold on to


@dataclass(frozen=True)
class Footage:
    """T frames, cut to the h x w pixels around what moves."""

    corner: tuple[int, int]
    """(u, v) of the cut's first pixel"""
    intrinsics: Array
    """[3 3] px, of the cut"""
    moving: NDArray[np.bool_]
    """[T h w] what is not still background"""
    look: Image
    """[T h w 2] brightness, and the outline of what moves (CONTRAST inside)"""
    flow: Image
    """[T-1 h w 2] px, to the next frame"""
    hold: Image
    """[T h w 3] uu, uv, vv of how well flow is determined: 1 along a gradient, 0 across none"""

    relief: Image | None = None
    """[T h w] inverse depth, a network's or measured, about 1"""
    part: NDArray[np.uint8] | None = None
    """[T h w] true parts, for an oracle"""

    @property
    def frames(self) -> int:
        return len(self.moving)


def footage(
    rgb: NDArray[np.uint8],
    intrinsics: Array,
    flow: Flow | NDArray[np.float32],
    depth: Depth | NDArray[np.float32] | None = None,
    part: NDArray[np.uint8] | None = None,
) -> Footage | None:
    """What the images [T H W 3] show; None if nothing moves.

    `flow` is an estimator or the flow itself [T-1 H W 2], `depth` likewise [T H W] (0: none); part
    [T H W] are true parts.
    """
    moving = moving_foreground(rgb) if part is None else part > 0
    if not moving.any():
        return None
    v, u = np.nonzero(moving.any(axis=0))
    box = (slice(max(0, int(v.min()) - _MARGIN), int(v.max()) + _MARGIN + 1),
           slice(max(0, int(u.min()) - _MARGIN), int(u.max()) + _MARGIN + 1))
    cut = np.ascontiguousarray(rgb[:, box[0], box[1]])
    inside = np.ascontiguousarray(moving[:, box[0], box[1]])
    k = intrinsics.astype(np.float64).copy()
    k[0, 2] -= box[1].start
    k[1, 2] -= box[0].start
    if isinstance(flow, np.ndarray):
        flows = np.nan_to_num(flow[:, box[0], box[1]])
    else:
        sized = for_cuts_of(flow, *rgb.shape[1:3])
        flows = np.stack([sized(cut[t], cut[t + 1]) for t in range(len(cut) - 1)])
    gray = np.stack([np.asarray(cv2.cvtColor(i, cv2.COLOR_RGB2GRAY), np.float32) for i in cut])
    relief = None
    if depth is not None:
        whole = depth if isinstance(depth, np.ndarray) else np.stack([depth(i) for i in rgb])
        far = whole[:, box[0], box[1]]
        middle = np.median(far[inside & (far > 0)]) if (inside & (far > 0)).any() else 1.0
        relief = (middle / np.where(far > 0, far, middle)).clip(0.5, 2.0)
    return Footage(
        (box[1].start, box[0].start),
        k,
        inside,
        np.stack([appearance(g, m) for g, m in zip(gray, inside, strict=True)]),
        np.ascontiguousarray(flows, np.float32),
        np.stack([gradients(g) for g in gray]),
        None if relief is None else relief.astype(np.float32),
        None if part is None else part[:, box[0], box[1]],
    )


def moving_foreground(rgb: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """[T H W] what differs from the background, which is what a pixel shows most of the time."""
    live = (rgb.max(axis=0) - rgb.min(axis=0)).max(axis=-1) > _CHANGED
    values = rgb[:, live].astype(np.int16)
    alike = np.zeros(values.shape[:2], np.int8)
    for a in range(len(values)):
        for b in range(a + 1, len(values)):
            same = np.abs(values[a] - values[b]).max(axis=-1) <= 1
            alike[a] += same
            alike[b] += same
    usual = values[alike.argmax(axis=0), np.arange(values.shape[1])]
    raw = np.zeros(rgb.shape[:3], np.uint8)
    raw[:, live] = np.abs(values - usual).max(axis=-1) > _UNLIKE
    return np.stack([_tidy(mask, live) for mask in raw])


def _tidy(mask: NDArray[np.uint8], live: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Without specks, and without the gaps where a plain surface looks the same for long."""
    out = cv2.morphologyEx(cv2.medianBlur(mask, 3), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    count, found, stats, _ = cv2.connectedComponentsWithStats(1 - out, connectivity=4)
    label = np.asarray(found, np.int64)
    size = stats[:, cv2.CC_STAT_AREA]
    still = np.bincount(label.ravel(), weights=~live.ravel(), minlength=count) / np.maximum(1, size)
    gap = (size < _GAP) | ((still > 0.3) & (size < _STILL_GAP))
    filled = (out > 0) | gap[label]
    _, found, stats, _ = cv2.connectedComponentsWithStats(filled.astype(np.uint8))
    large = stats[:, cv2.CC_STAT_AREA] >= _SPECK
    large[0] = False
    return np.asarray(large[np.asarray(found, np.int64)], bool)


def appearance(gray: Image, moving: NDArray[np.bool_]) -> Image:
    """[h w 2] brightness and outline of a frame, a little blurred."""
    outline = cv2.GaussianBlur(moving.astype(np.float32) * CONTRAST, (0, 0), 1.0)
    return np.stack([cv2.GaussianBlur(gray, (0, 0), 0.8), outline], axis=2).astype(np.float32)


def gradients(gray: Image) -> Image:
    """[h w 3] uu, uv, vv: 1 where brightness changes strongly in a direction, 0 where it does not.

    The structure tensor's eigenvalues l become l / (l + texture): flow is known across an edge,
    guessed along it, and invented where there is nothing to see.
    """
    smooth = cv2.GaussianBlur(gray, (0, 0), 1.0)
    du = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=0.125)
    dv = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=0.125)
    uu, uv, vv = (cv2.GaussianBlur(x, (0, 0), 2.0) for x in (du * du, du * dv, dv * dv))
    apart = np.sqrt((uu - vv) ** 2 + 4 * uv * uv)
    most, least = (uu + vv + apart) / 2, np.maximum(uu + vv - apart, 0) / 2
    first, second = most / (most + _TEXTURE), least / (least + _TEXTURE)
    slope = (first - second) / np.maximum(apart, 1e-6)
    return np.stack(
        [second + slope * (uu - least), slope * uv, second + slope * (vv - least)], axis=2
    ).astype(np.float32)
