"""Parts from motion: labels by residuals that are accumulated over all frames (Sec. 3.2, EM).

The paper assigns a pixel to the part whose epipolar loss is least, between two frames. With depth
the residual is where the hypothesis puts the pixel's point against what the later frame measures
there, over every frame; a point in front of the measured surface contradicts free space, a point
behind it may be hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from ..robots.geometry import Array, inverse
from .crew import together
from .kernels import add_label_costs, camera_of, columns
from .surface import Surfaces

_NEAR, _NOISY = (5, 5), 5.0  # window of a label's costs; standard deviation of a noisy one's
_SAME = 1.5e-4  # m, between two measurements of one still point


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


def changed(surfaces: Surfaces, frame: int) -> NDArray[np.bool_]:
    """[H W] whether a pixel's depth ever differs from that in `frame`."""
    here = surfaces.depth[frame]
    tolerance = surfaces.tolerance(here)
    out = np.zeros(here.shape, bool)
    for depth in surfaces.depth:
        out |= np.abs(depth - here) > tolerance
    return out


def settled(surfaces: Surfaces, rgb: NDArray[np.uint8], frame: int) -> NDArray[np.bool_]:
    """[H W] whether a pixel of `frame` looks still: never seen through, and seen again unchanged.

    What hides it later may be near it for long; where it reappears, or has not been hidden yet,
    its depth is the same to the last digit.
    """
    here = surfaces.depth[frame]
    again = np.zeros(here.shape, np.int64)
    through = np.zeros(here.shape, bool)
    for t, depth in enumerate(surfaces.depth):
        if t == frame:
            continue
        same = np.abs(depth - here) < _SAME + 5 * surfaces.noise
        if surfaces.noise:
            same &= alike(rgb[t], rgb[frame])
        again += np.where(same, 3 if abs(t - frame) == 1 else 1, 0)
        through |= (depth > here + surfaces.tolerance(here) + 20 * surfaces.noise) | (depth == 0)
    return ~through & (again >= 3)


def alike(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """[H W] whether two images show the same around a pixel."""
    red, green, blue = cv2.split(cv2.blur(cv2.absdiff(a, b), (3, 3)))
    return cv2.max(red, cv2.max(green, blue)) <= 2


def lively(surfaces: Surfaces, rgb: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """[T H W] in and around the pixels of each frame that change."""

    def of(frame: int) -> NDArray[np.bool_]:
        moving = changed(surfaces, frame).astype(np.uint8)
        wide = cv2.dilate(moving, np.ones((9, 9), np.uint8)) > 0
        return wide & surfaces.normal[frame].any(axis=2) & ~settled(surfaces, rgb, frame)

    return np.stack(together(of, range(surfaces.frames)))


def candidates(
    surfaces: Surfaces, where: NDArray[np.bool_], frame: int, most: int
) -> Candidates:
    """At most about `most` of the pixels of a frame that are told [H W]."""
    stride = max(1, int(np.ceil(np.sqrt(np.count_nonzero(where) / most))))
    v, u = np.nonzero(where[::stride, ::stride])
    pixel = np.stack([u, v], axis=1) * stride
    normal = surfaces.normal[frame, pixel[:, 1], pixel[:, 0]].astype(np.float64)
    return Candidates(frame, pixel, surfaces.points(frame, pixel), normal, stride)


def label_costs(
    surfaces: Surfaces, grid: Candidates, motion: Array, width: float = 1.0, first: int = 0
) -> Array:
    """[N P] cost of each label for the candidates under motion [T P 4 4] of the parts `first` to
    `first` + P - 1, over T - 1 frames.

    `width` is what the motion may err by, in footprints of a pixel.
    """
    scale = width * (surfaces.footprint(grid.point[:, 2]) + surfaces.noise)
    here_from_there = motion @ inverse(motion[grid.frame])
    out = np.zeros((motion.shape[1], len(grid.point)), np.float32)
    add_label_costs(surfaces.depth, surfaces.normal, camera_of(surfaces.intrinsics, surfaces.depth),
                    grid.frame, here_from_there.astype(np.float32), first,
                    columns(grid.point, grid.normal, scale), out)
    return out.T.astype(np.float64)


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
