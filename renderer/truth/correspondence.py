"""Optical flow and visibility in closed form, from depth, part numbers and poses.

A surface point that is seen at pixel x with depth z belongs to a rigid part (or to the world). Its
position in another frame follows from the part's two poses; its projection minus x is the flow.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, inverse
from ..types import BACKGROUND, OCCLUDED, OUT_OF_IMAGE, VISIBLE

DEPTH_TOLERANCE = 0.002
"""Depths of one part that differ by less than this share of the depth are the same surface."""


def pose_table(cam_from_world: Array, world_from_part: Array) -> Array:
    """cam_from_X [T P+1 4 4] by part number: row 0 is the world, row p the part of number p.

    From cam_from_world [T 4 4] and world_from_part [T P 4 4].
    """
    world = cam_from_world[:, None]
    return np.concatenate([world, world @ world_from_part], axis=1)


@dataclass(frozen=True)
class Moved:
    """Where the N points of a `SurfacePoints` are in another frame."""

    flow: NDArray[np.float32]
    """[2 N] (du, dv) px; NaN behind the camera."""
    depth: NDArray[np.float32]
    """[N] m there; NaN behind the camera."""


@dataclass(frozen=True)
class SurfacePoints:
    """What N pixels of a frame show: points of parts (and of the world, if it moves), by part."""

    still: NDArray[np.float32]
    """[H W 2] flow of what does not move: 0, and NaN where there is no surface."""
    index: NDArray[np.int32]
    """[N] of the pixel in the flattened image"""
    first: NDArray[np.int64]
    """[P+2] where each part number's points begin in the arrays of N, and the end."""
    u: NDArray[np.int32]
    """[N] px"""
    v: NDArray[np.int32]
    """[N] px"""
    points: Array
    """[3 N] m in the camera frame"""
    intrinsics: Array
    """[3 3] px"""

    @property
    def part_pixels(self) -> NDArray[np.int64]:
        """[P] pixels of each part."""
        return np.diff(self.first)[1:]

    def moved(self, here: Array, there: Array) -> Moved:
        """The points in another frame, from the pose tables [P+1 4 4] of the two instants."""
        k = self.intrinsics
        flow = np.zeros((2, len(self.index)), np.float32)
        depth = self.points[2].astype(np.float32)
        move = there @ inverse(here)
        for number in np.flatnonzero(np.diff(self.first)):
            if np.array_equal(here[number], there[number]):
                continue  # exactly zero
            chosen = slice(self.first[number], self.first[number + 1])
            x, y, z = move[number, :3, :3] @ self.points[:, chosen] + move[number, :3, 3:]
            if z.min() <= 0:
                z[z <= 0] = np.nan
            x, y = x / z, y / z
            flow[0, chosen] = k[0, 0] * x + k[0, 1] * y + k[0, 2] - self.u[chosen]
            flow[1, chosen] = k[1, 1] * y + k[1, 2] - self.v[chosen]
            depth[chosen] = z
        return Moved(flow, depth)

    def flow_image(self, moved: Moved) -> NDArray[np.float32]:
        """Flow [H W 2] px; NaN where there is no surface."""
        out = self.still.copy()
        for axis in (0, 1):
            out.reshape(-1, 2)[self.index, axis] = moved.flow[axis]
        return out


def surface_points(
    depth: NDArray[np.float32], part: NDArray[np.uint16], k: Array, parts: int,
    world_moves: bool = False,
) -> SurfacePoints:
    """Points of a frame from depth [H W] m (0: no surface), part numbers [H W] in 0..parts and
    intrinsics [3 3]. Those of the world are left out, with zero flow, unless it `moves` (against
    the camera).
    """
    seen = np.flatnonzero(depth > 0 if world_moves else part > 0)  # bool: five times faster
    number = part.ravel()[seen]
    order = np.argsort(number, kind="stable")  # a radix sort; parts become slices
    index = seen[order].astype(np.int32)
    first = np.searchsorted(number[order], np.arange(parts + 2))
    v = index // depth.shape[1]
    u = index - v * depth.shape[1]
    z = depth.ravel()[index].astype(np.float64)
    y = (v - k[1, 2]) / k[1, 1]
    x = (u - k[0, 2] - k[0, 1] * y) / k[0, 0]
    still = np.where(depth == 0, np.float32(np.nan), np.float32(0.0))
    points = np.stack([x * z, y * z, z])
    flow = np.asarray(cv2.merge([still, still]), np.float32)
    return SurfacePoints(flow, index, first, u, v, points, k)


def visibility(
    points: SurfacePoints,
    moved: Moved,
    next_depth: NDArray[np.float32],
    next_part: NDArray[np.uint16],
    depth_unit: float,
) -> NDArray[np.uint8]:
    """Whether each part pixel's correspondence is seen in the next frame, [H W] (sequence.py).

    A point is visible if, among the four pixels around its target, some show the same part, and
    its depth lies between theirs (give or take DEPTH_TOLERANCE or two depth units): part identity
    and depth decide, as surfaces at a silhouette are nearer to each other in the image than in
    space (lessons 7). `moved` says where the points are in the next frame, whose depth [H W] m and
    parts [H W] follow.
    """
    height, width = next_part.shape
    u, v = points.u + moved.flow[0].astype(np.float64), points.v + moved.flow[1].astype(np.float64)
    inside = (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
    left = np.floor(np.where(inside, u, 0)).astype(np.int32)
    top = np.floor(np.where(inside, v, 0)).astype(np.int32)
    columns = [np.clip(left + dx, 0, width - 1) for dx in (0, 1)]
    rows = [np.clip(top + dy, 0, height - 1) * np.int32(width) for dy in (0, 1)]
    number = np.repeat(np.arange(len(points.first) - 1, dtype=np.uint16), np.diff(points.first))
    nearest = np.full(len(u), np.inf, np.float32)
    farthest = np.full(len(u), -np.inf, np.float32)
    for row in rows:
        for column in columns:
            pixel = row + column
            there = next_depth.ravel()[pixel]
            other = next_part.ravel()[pixel] != number
            nearest = np.minimum(nearest, np.where(other, np.float32(np.inf), there))
            farthest = np.maximum(farthest, np.where(other, np.float32(-np.inf), there))
    tolerance = np.maximum(np.float32(2.0 * depth_unit), np.float32(DEPTH_TOLERANCE) * moved.depth)
    seen = (moved.depth >= nearest - tolerance) & (moved.depth <= farthest + tolerance)
    answer = np.where(seen, np.uint8(VISIBLE), np.uint8(OCCLUDED))
    answer[~inside] = OUT_OF_IMAGE
    answer[:points.first[1]] = BACKGROUND  # of the world
    out = np.full(next_part.shape, BACKGROUND, np.uint8)
    out.ravel()[points.index] = answer
    return out
