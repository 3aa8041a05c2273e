"""Neighbourhoods of pixels and of points."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from ...robots.geometry import Array

_NEAR, _NOISY = (5, 5), 5.0  # window of a label's costs; standard deviation of a noisy one's


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
    """Pixels from one to the next."""


def smooth(cost: Array, grid: Candidates, noisy: bool = False) -> Array:
    """Mean of the costs [N L] over the candidates around each, on the grid.

    Noise needs far more of them, and blurs the parts' borders less than it helps.
    """
    at = grid.pixel // grid.stride
    shape = (int(at[:, 1].max()) + 1, int(at[:, 0].max()) + 1)
    image = np.zeros((*shape, cost.shape[1] + 1), np.float32)
    image[at[:, 1], at[:, 0], :-1] = cost
    image[at[:, 1], at[:, 0], -1] = 1.0

    around = cv2.BORDER_CONSTANT
    total = np.stack([
        cv2.GaussianBlur(c, (0, 0), _NOISY, borderType=around) if noisy
        else cv2.blur(c, _NEAR, borderType=around)
        for c in np.ascontiguousarray(image.transpose(2, 0, 1))
    ], axis=2)
    mean = total[..., :-1] / np.maximum(total[..., -1:], 1e-6)
    return mean[at[:, 1], at[:, 0]].astype(np.float64)


def order_from_base(points: Array, still: Array) -> Array:
    """[N] rank in 0..1 of moving points by their way along the surface from the still ones.

    points [N 3], still [M 3]. Hops count by their squared length, so that the way follows the
    body and jumps gaps only where it must.
    """
    pick = np.linspace(0, len(points) - 1, min(len(points), 500)).astype(int)
    some = points[pick]
    if len(still):
        to_still = cdist(some, still[:: max(1, len(still) // 1000)]).min(axis=1)
    else:
        to_still = np.zeros(len(some))
    graph = cdist(some, some) ** 2
    source = to_still <= np.quantile(to_still, 0.02)
    way = dijkstra(graph + 1e-12, indices=np.flatnonzero(source), min_only=True)
    rank = np.argsort(np.argsort(way)) / max(1, len(some) - 1)
    return rank[cdist(points, some).argmin(axis=1)]
