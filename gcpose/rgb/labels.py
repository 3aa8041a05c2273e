"""Parts of a video without depth (Sec. 3.2, EM): which part's motion explains a pixel best.

What speaks for a part (see ray_costs.py) is averaged over neighbours and along tracks, and parts
follow one another from the base outward.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from ...robots.geometry import Array
from ..images import Footage, rays

_NEAR = 12  # neighbours that share a label
_AROUND = 1.5  # cells within which a pixel of another key frame shows the same
_OUT_OF_ORDER = 0.2  # cost of a label that does not follow the way from the base outward


@dataclass(frozen=True)
class Spots:
    """N pixels of key frames that are worth following."""

    frame: NDArray[np.int64]
    """[N]"""
    pixel: NDArray[np.int64]
    """[N 2]"""
    ray: Array
    """[N 3] at depth 1"""
    expected: Array
    """[N] inverse depth, if nothing else is known"""
    part: NDArray[np.int64] | None
    """[N] 1..J, if it is given"""
    near: csr_array
    """[N N] 1 for a pixel's neighbours"""
    nearest: NDArray[np.int32]
    """[K h w] in each key frame the pixel that is nearest to each, -1 where none is near"""

    def average(self, values: Array) -> Array:
        """Means [N C] of values [N C] over each pixel's neighbourhood."""
        total: Array = self.near @ values
        return total / np.maximum(1.0, self.near.sum(axis=1))[:, None]


def spots(seen: Footage, frames: tuple[int, ...], most: int) -> Spots:
    """About `most` pixels of each key frame: the most distinct one of each cell."""
    pixel: list[NDArray[np.int64]] = []
    frame: list[NDArray[np.int64]] = []
    blocks: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
    first = 0
    around: list[NDArray[np.int32]] = []
    for k in frames:
        # its rim is as likely background, and more textured
        mask = cv2.erode(seen.moving[k].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        cell = max(2, int(np.ceil(np.sqrt(np.count_nonzero(mask) / most))))
        score = np.where(mask, seen.hold[k, ..., 0] + seen.hold[k, ..., 2], -1.0)
        h, w = score.shape[0] // cell, score.shape[1] // cell
        cells = score[: h * cell, : w * cell].reshape(h, cell, w, cell).swapaxes(1, 2)
        cells = cells.reshape(h, w, -1)
        best = cells.argmax(axis=2)
        v, u = np.nonzero(cells.max(axis=2) >= 0)
        inside = best[v, u]
        here = np.stack([u * cell + inside % cell, v * cell + inside // cell], axis=1)
        pixel.append(here)
        frame.append(np.full(len(here), k))
        if len(here):
            _, others = KDTree(here).query(here, min(_NEAR, len(here)))
            others = np.asarray(others, np.int64).reshape(len(here), -1)
            row = np.repeat(np.arange(len(here)), others.shape[1])
            blocks.append((row + first, others.ravel() + first))
            index = nearest_of(here, mask.shape, _AROUND * cell)
            around.append(np.where(index >= 0, index + np.int32(first), index))
        first += len(here)
    pixels = np.concatenate(pixel)
    row = np.concatenate([b[0] for b in blocks]) if blocks else np.zeros(0, np.int64)
    column = np.concatenate([b[1] for b in blocks]) if blocks else np.zeros(0, np.int64)
    near = csr_array((np.ones(len(row)), (row, column)), shape=(first, first))
    at = (np.concatenate(frame), pixels[:, 1], pixels[:, 0])
    expected = np.ones(first) if seen.relief is None else seen.relief[at].astype(np.float64)
    part = None if seen.part is None else np.maximum(1, seen.part[at].astype(np.int64))
    nearest = np.stack(around) if around else np.zeros((0, *seen.moving.shape[1:]), np.int32)
    return Spots(at[0], pixels, rays(seen.intrinsics, pixels), expected, part, near, nearest)


def nearest_of(
    pixels: NDArray[np.int64], shape: tuple[int, ...], reach: float
) -> NDArray[np.int32]:
    """[h w] index of the nearest of pixels [N 2], -1 where none is within `reach` px."""
    marks = np.ones(shape, np.uint8)
    marks[pixels[:, 1], pixels[:, 0]] = 0
    away, found = cv2.distanceTransformWithLabels(
        marks, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    mark = np.asarray(found, np.int64)
    index = np.zeros(len(pixels) + 1, np.int32)
    index[mark[pixels[:, 1], pixels[:, 0]]] = np.arange(len(pixels))
    return np.where(np.asarray(away) < reach, index[mark], np.int32(-1))


def along_tracks(points: Spots, cost: Array, place: Array) -> Array:
    """[N J] costs averaged over neighbours, and over what each part takes a pixel to.

    place [N K J 2] px, of each pixel in each key frame if it is on part j: what is seen there would
    be the same part.
    """
    keys, height, width = points.nearest.shape
    pixel = np.rint(np.clip(place, -2, 1e4)).astype(np.int64)
    u, v = pixel[..., 0], pixel[..., 1]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    there = points.nearest[np.arange(keys)[:, None], np.where(inside, v, 0), np.where(inside, u, 0)]
    own = points.frame[:, None] == np.unique(points.frame)
    found = inside & (there >= 0) & ~own[..., None]
    part = np.arange(cost.shape[1])
    for _ in range(2):
        near = points.average(cost)
        others = np.where(found, near[there, part], 0.0).sum(axis=1)
        cost = (near + others) / (1 + found.sum(axis=1))
    return cost


def labelled(points: Spots, cost: Array, rank: Array) -> NDArray[np.int64]:
    """[N] labels 0..J-1 of least cost [N J], most of which follow one another from the base
    outward: rank [N] is 0..1 on the way, which a folded chain does not keep to."""
    order = along_chain(cost, rank, points.frame)
    out = np.arange(cost.shape[1]) != order[:, None]
    return points.average(cost + _OUT_OF_ORDER * out).argmin(axis=1)


def along_chain(cost: Array, rank: Array, frame: NDArray[np.int64]) -> NDArray[np.int64]:
    """[N] labels 0..J-1 that follow one another from the base outward, of least cost.

    cost [N J], rank [N] in 0..1 from the base outward, key frame of each [N].
    """
    out = np.zeros(len(rank), np.int64)
    joints = cost.shape[1]
    for k in np.unique(frame):
        mine = np.flatnonzero(frame == k)
        mine = mine[np.argsort(rank[mine], kind="stable")]
        total = np.concatenate([np.zeros((1, joints)), np.cumsum(cost[mine], axis=0)])
        best = total[:, 0]  # of the points before each place, if the last is on part j
        origin: list[NDArray[np.int64]] = []
        for j in range(1, joints):
            gain = best - total[:, j]
            least = np.minimum.accumulate(gain)
            first = np.arange(len(gain))
            first[gain > least] = 0
            origin.append(np.maximum.accumulate(first))
            best = least + total[:, j]
        end = len(mine)
        for j in range(joints - 1, 0, -1):
            begin = int(origin[j - 1][end])
            out[mine[begin:end]] = j
            end = begin
    return out


def disorder(label: NDArray[np.int64], rank: Array, frame: NDArray[np.int64]) -> float:
    """Share of the pairs of a frame's points that are labelled against their rank [N] from the
    base outward: two parts that are taken for each other explain as much, but not in this order."""
    against, pairs = 0, 0
    for k in np.unique(frame):
        mine = np.flatnonzero(frame == k)
        own = label[mine[np.argsort(rank[mine], kind="stable")]]
        for outer in np.unique(own):
            before = np.cumsum(own == outer)
            against += int(before[own < outer].sum())
        pairs += len(own) * (len(own) - 1) // 2
    return against / max(1, pairs)
