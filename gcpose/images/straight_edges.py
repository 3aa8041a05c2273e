"""Straight edges in the images of a still camera: of what moves, and of what does not."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image, thread_map
from .settings import ImageSettings

_SAMPLES = 9  # places along an edge that are looked up
_STILL_FRAMES = 4  # in which still edges are searched


def moving_edges(
    gray: Image, moving: NDArray[np.bool_], settings: ImageSettings
) -> list[Array]:
    """Return the straight edges of what moves [T h w], by the brightness [T h w] of T frames: the
    ends [N 2 2] of those of each frame, px.

    The line segment detector of Grompone von Gioi et al. (LSD, PAMI 2010) finds them. Short ones
    are left out, and those that are seen at the same place long before or after: they do not move.
    """
    s = settings
    found = thread_map(_find_edges, gray)
    least = _least_length(moving, s)
    found = [ends[_lengths(ends) > s.still_edge_overlap * least] for ends in found]
    out: list[Array] = []
    for t, ends in enumerate(found):
        mine = ends[_lengths(ends) > least]
        mine = mine[_is_near(mine, moving[t], s)]
        distant = [k for k in range(len(found)) if abs(k - t) >= max(1, len(found) // 3)]
        looked_at = distant[:: len(distant) // s.still_edge_frames + 1]
        seen = np.zeros(len(mine))
        for k in looked_at:
            seen += _is_among(mine, found[k], s)
        out.append(mine[seen <= s.still_edge_share * len(looked_at)])
    return out


def still_edges(gray: Image, moving: NDArray[np.bool_], settings: ImageSettings) -> Array:
    """Return the straight edges that do not move, by the brightness [T h w] of T frames: the ends
    [N 2 2] of those of a few frames that are seen at the same place in most of these, px. Edges
    that are short by what moves [T h w] are left out."""
    s = settings
    looked_at = np.unique(np.linspace(0, len(gray) - 1, _STILL_FRAMES).astype(np.int64))
    found, least = thread_map(_find_edges, gray[looked_at]), _least_length(moving, s)
    out: list[Array] = []
    for k, ends in enumerate(found):
        mine = ends[_lengths(ends) > least]
        others = [other for i, other in enumerate(found) if i != k]
        seen = np.sum([_is_among(mine, other, s) for other in others], axis=0)
        out.append(mine[seen > len(others) / 2])
    return np.concatenate(out)


def _find_edges(gray: Image) -> Array:
    """Ends [N 2 2] of all straight edges in an image [h w], px."""
    image = gray.astype(np.uint8)
    found: Any = cv2.createLineSegmentDetector(cv2.LSD_REFINE_ADV).detect(image)[0]
    return np.asarray([] if found is None else found, np.float64).reshape(-1, 2, 2)


def _least_length(moving: NDArray[np.bool_], settings: ImageSettings) -> float:
    """Length below which edges are left out, by what moves [T h w], px."""
    return settings.min_edge_length * float(np.sqrt(np.median(moving.sum(axis=(1, 2)))))


def _lengths(ends: Array) -> Array:
    return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), np.float64)


def _is_near(ends: Array, moving: NDArray[np.bool_], settings: ImageSettings) -> NDArray[np.bool_]:
    """Whether most of each edge [N 2 2] is in or near what moves [h w]."""
    window = np.ones((2 * settings.edge_margin + 1,) * 2, np.uint8)
    near = cv2.dilate(moving.astype(np.uint8), window) > 0
    share = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    pixel = np.rint(ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])).astype(np.int64)
    u, v = (pixel[..., i].clip(0, moving.shape[1 - i] - 1) for i in (0, 1))
    return np.asarray(near[v, u].mean(axis=1) >= settings.min_edge_share, np.bool_)


def _is_among(ends: Array, others: Array, settings: ImageSettings) -> NDArray[np.bool_]:
    """Whether each edge [N 2 2] lies on one of other edges [M 2 2]."""
    length = _lengths(ends)[:, None]
    along = (ends[:, 1] - ends[:, 0]) / length
    across = along[:, ::-1] * [-1, 1]
    place = others - ends[:, 0, None, None]  # [N M 2 2]
    away = np.abs(np.einsum("nmei,ni->nme", place, across)).max(axis=2)
    at = np.einsum("nmei,ni->nme", place, along)
    common = np.minimum(at.max(axis=2), length) - np.maximum(at.min(axis=2), 0.0)
    alike = (away < settings.still_edge_distance) & (common > settings.still_edge_overlap * length)
    return np.asarray(alike.any(axis=1), np.bool_)
