"""Part labels without depth (Sec. 3.2, EM).

Label costs (see `costs`) are averaged over neighbors and along tracks; parts are expected to follow
one another from the base outward.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from ...robots.geometry import Array, pinhole
from ..images import VideoEvidence
from .outline import Outline, OutlineKind, edges_near_outline, sample_outline, surfaces_at_outline
from .settings import RgbSettings


@dataclass(frozen=True, eq=False)
class SampledPixels:
    """N pixels of K key frames, each with texture to follow or on the outline."""

    frame: NDArray[np.int64]
    """[N] key frame"""
    pixel: NDArray[np.int64]
    """[N 2] (u, v)"""
    ray: Array
    """[N 3] at depth 1"""
    expected: Array
    """[N] prior mean of the inverse depth"""
    part: NDArray[np.int64] | None
    """[N] 1..J, if it is given"""
    outline: Outline
    """Which pixels are on the outline"""
    neighbors: csr_array
    """[N N] 1 for a pixel's neighbors and itself"""
    nearest: NDArray[np.int32]
    """[K h w] index of the pixel that is nearest to each place of a key frame, -1 where none is
    near"""

    def average(self, values: Array) -> Array:
        """Return the means [N C] of values [N C] over each pixel's neighbors."""
        total: Array = self.neighbors @ values
        return total / self._count

    @cached_property
    def _count(self) -> Array:
        """[N 1] neighbors, at least 1."""
        return np.maximum(1.0, self.neighbors.sum(axis=1))[:, None]


def sample_pixels(
    evidence: VideoEvidence, frames: tuple[int, ...], most: int, settings: RgbSettings,
    outline: OutlineKind = "none",
) -> SampledPixels:
    """Sample about `most` pixels of each key frame: the one with most texture of each cell; and one
    of each cell on the `outline`, if asked for.

    The outline of a thick door is deeper than its face. So pixels on its edges and inside are no
    neighbors.
    """
    found = [_sample_frame(evidence, k, most, outline, settings) for k in frames]
    first = np.cumsum([0, *(len(pixel) for pixel, _, _ in found)])
    row, column, nearest = [], [], []
    for at, (here, on, cell) in zip(first, found, strict=False):
        if not len(here):
            continue
        groups = [~on, on] if outline == "edge" else [np.full(len(here), True)]
        for group in map(np.flatnonzero, groups):
            pairs = _nearest_pairs(here[group], settings.label_neighbors)
            row.append(group[pairs[0]] + at)
            column.append(group[pairs[1]] + at)
        index = nearest_sample(here, evidence.moving.shape[1:], settings.same_pixel_cells * cell)
        nearest.append(np.where(index >= 0, index + np.int32(at), index))
    none = [np.zeros(0, np.int64)]
    rows, columns = np.concatenate(row or none), np.concatenate(column or none)
    pixels = np.concatenate([pixel for pixel, _, _ in found])
    on = np.concatenate([on for _, on, _ in found])
    at = (np.repeat(frames, np.diff(first)), pixels[:, 1], pixels[:, 0])
    if outline == "edge":
        surface = edges_near_outline(
            evidence.moving, at[0], pixels, on, settings.edge_radius, settings.edge_reach)
    else:
        surface = surfaces_at_outline(evidence.moving, evidence.intrinsics, at[0], pixels, on)
    depth, part = evidence.inverse_depth, evidence.part
    return SampledPixels(
        at[0], pixels, pinhole.pixel_rays(evidence.intrinsics, pixels),
        np.ones(len(pixels)) if depth is None else depth[at].astype(np.float64),
        None if part is None else np.maximum(1, part[at].astype(np.int64)),
        surface,
        csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(pixels), len(pixels))),
        np.stack(nearest) if nearest else np.zeros((0, *evidence.moving.shape[1:]), np.int32),
    )


def _nearest_pairs(
    pixels: NDArray[np.int64], most: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each of pixels [N 2] with each of the `most` nearest of them, itself included."""
    count = min(most, len(pixels))
    if not count:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    _, others = KDTree(pixels).query(pixels, count)
    return np.repeat(np.arange(len(pixels)), count), np.asarray(others, np.int64).ravel()


def _sample_frame(
    evidence: VideoEvidence, frame: int, most: int, outline: OutlineKind, settings: RgbSettings
) -> tuple[NDArray[np.int64], NDArray[np.bool_], int]:
    """Pixels [N 2] of a frame, whether each is on the outline [N], and the side of the cells that
    they are from, px."""
    moving, confidence = evidence.moving[frame], evidence.texture_confidence[frame]
    rim = settings.rim_width if outline == "round" else settings.rim_width_search
    # at the rim, brightness shows the background or shading, which do not move with the surface
    mask = cv2.erode(moving.astype(np.uint8), np.ones((2 * rim + 1, 2 * rim + 1), np.uint8)) > 0
    cell = max(2, int(np.ceil(np.sqrt(np.count_nonzero(mask) / most))))
    score = np.where(mask, confidence[..., 0] + confidence[..., 2], -1.0)
    h, w = score.shape[0] // cell, score.shape[1] // cell
    cells = score[: h * cell, : w * cell].reshape(h, cell, w, cell).swapaxes(1, 2)
    cells = cells.reshape(h, w, -1)
    best = cells.argmax(axis=2)
    v, u = np.nonzero(cells.max(axis=2) >= 0)
    inside = best[v, u]
    inner = np.stack([u * cell + inside % cell, v * cell + inside // cell], axis=1)
    outer = inner[:0] if outline == "none" else sample_outline(moving, cell)
    on = np.repeat([False, True], [len(inner), len(outer)])
    return np.concatenate([inner, outer]), on, cell


def nearest_sample(
    pixels: NDArray[np.int64], shape: tuple[int, ...], reach: float
) -> NDArray[np.int32]:
    """Return the index [h w] of the nearest of pixels [N 2], -1 where none is within `reach` px."""
    marks = np.ones(shape, np.uint8)
    marks[pixels[:, 1], pixels[:, 0]] = 0
    away, found = cv2.distanceTransformWithLabels(
        marks, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    mark = np.asarray(found, np.int64)
    index = np.zeros(len(pixels) + 1, np.int32)
    index[mark[pixels[:, 1], pixels[:, 0]]] = np.arange(len(pixels))
    return np.where(np.asarray(away) < reach, index[mark], np.int32(-1))


def average_along_tracks(points: SampledPixels, cost: Array, place: Array) -> Array:
    """Return label costs [N J] averaged over neighbors and along each part's tracks.

    place [N K J 2] px, of each pixel in each key frame if it is on part j: the pixel seen there
    would be on the same part.
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


def assign_labels(
    points: SampledPixels, cost: Array, rank: Array, order_cost: float
) -> NDArray[np.int64]:
    """Return the labels 0..J-1 [N] of least cost [N J].

    Rank [N] is 0..1 from the base outward. A folded chain does not keep to it, so that a label out
    of order costs `order_cost` and is not forbidden.
    """
    order = ordered_labels(cost, rank, points.frame)
    out = np.arange(cost.shape[1]) != order[:, None]
    return points.average(cost + order_cost * out).argmin(axis=1)


def ordered_labels(cost: Array, rank: Array, frame: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the labels 0..J-1 [N] of least cost [N J] that follow one another by rank.

    Dynamic programming over the points of each key frame [N], by rank [N] in 0..1 from the base
    outward.
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


def label_inversions(label: NDArray[np.int64], rank: Array, frame: NDArray[np.int64]) -> float:
    """Return the share of the pairs of a frame's points that are labeled against their rank [N].

    Two parts that are mistaken for each other explain the images equally well, but not in order.
    """
    against, pairs = 0, 0
    for k in np.unique(frame):
        mine = np.flatnonzero(frame == k)
        own = label[mine[np.argsort(rank[mine], kind="stable")]]
        for outer in np.unique(own):
            before = np.cumsum(own == outer)
            against += int(before[own < outer].sum())
        pairs += len(own) * (len(own) - 1) // 2
    return against / max(1, pairs)
