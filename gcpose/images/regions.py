"""Neighborhoods of pixels and of points."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from ...robots.geometry import Array
from .settings import ImageSettings


@dataclass(frozen=True)
class Candidates:
    """Points of a frame that may move, on a grid of pixels."""

    frame: int
    pixel: NDArray[np.int64]
    """[N 2] (u, v)"""
    point: Array
    """[N 3] m"""
    normal: Array
    """[N 3]"""
    stride: int
    """Pixels from one to the next"""
    settings: ImageSettings


def bounding_box(mask: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """Return the rows and columns of a mask [H W] with a margin, px."""
    rows, columns = (slice(max(0, int(x.min()) - margin), int(x.max()) + margin + 1)
                     for x in np.nonzero(mask))
    return rows, columns


def smooth_costs(cost: Array, grid: Candidates, noisy: bool = False) -> Array:
    """Return the mean of costs [N L] over the candidates around each, on the grid.

    Noisy costs need a wider window, which blurs the borders of parts less than it helps.
    """
    at, settings = grid.pixel // grid.stride, grid.settings
    shape = (int(at[:, 1].max()) + 1, int(at[:, 0].max()) + 1)
    image = np.zeros((*shape, cost.shape[1] + 1), np.float32)
    image[at[:, 1], at[:, 0], :-1] = cost
    image[at[:, 1], at[:, 0], -1] = 1.0
    border, window = cv2.BORDER_CONSTANT, (settings.label_window, settings.label_window)
    total = np.stack([
        cv2.GaussianBlur(c, (0, 0), settings.noisy_label_sigma, borderType=border) if noisy
        else cv2.blur(c, window, borderType=border)
        for c in np.ascontiguousarray(image.transpose(2, 0, 1))
    ], axis=2)
    mean = total[..., :-1] / np.maximum(total[..., -1:], 1e-6)
    return mean[at[:, 1], at[:, 0]].astype(np.float64)


def geodesic_rank(points: Array, static: Array, settings: ImageSettings) -> Array:
    """Return the rank [N] in 0..1 of moving points by their geodesic distance from static ones.

    points [N 3], static [M 3]. Steps count by their squared length, so that paths follow the body
    and cross gaps only where they must.
    """
    most = settings.rank_points
    pick = np.linspace(0, len(points) - 1, min(len(points), most)).astype(int)
    some = points[pick]
    if len(static):
        step = max(1, len(static) // settings.rank_static_points)
        to_static = cdist(some, static[::step]).min(axis=1)
    else:
        to_static = np.zeros(len(some))
    graph = cdist(some, some) ** 2
    source = to_static <= np.quantile(to_static, settings.rank_source_share)
    length = dijkstra(graph + 1e-12, indices=np.flatnonzero(source), min_only=True)
    rank = np.argsort(np.argsort(length)) / max(1, len(some) - 1)
    return rank[cdist(points, some).argmin(axis=1)]
