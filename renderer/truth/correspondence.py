"""Optical flow and visibility in closed form, from depth, part numbers and poses.

A surface point that is seen at pixel x with depth z belongs to a rigid part (or to the world). Its
position in another frame follows from the part's two poses; its projection minus x is the flow.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, apply, inverse, pinhole
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
class PointMotion:
    """Where the N points of a `SurfacePoints` are in another frame."""

    flow: NDArray[np.float32]
    """[N 2] (du, dv) px; NaN behind the camera"""
    depth: NDArray[np.float32]
    """[N] m; NaN behind the camera"""


@dataclass(frozen=True)
class SurfacePoints:
    """What N pixels of a frame show: points of parts (and of the world, if the camera moves), in
    the order of the parts.

    `points` lie in memory column by column, which makes `moved` faster.
    """

    still: NDArray[np.float32]
    """[H W 2] px, flow of what is not among the points: 0, and NaN where there is no surface"""
    index: NDArray[np.int32]
    """[N] of the pixel in the flattened image"""
    first: NDArray[np.int64]
    """[P+2] where each part number's points begin in the arrays of N, and the end"""
    pixels: Array
    """[N 2] px, (u, v)"""
    points: Array
    """[N 3] m in the camera frame"""
    intrinsics: Array
    """[3 3] px"""

    @property
    def part_pixels(self) -> NDArray[np.int64]:
        """[P] number of pixels of each part."""
        return np.diff(self.first)[1:]

    def of_part(self, number: int) -> slice:
        """The points of a part number, in the arrays of N."""
        return slice(int(self.first[number]), int(self.first[number + 1]))

    def motion(self, here: Array, there: Array) -> PointMotion:
        """The points in another frame, from the pose tables [P+1 4 4] of the two instants."""
        flow = np.zeros((len(self.index), 2), np.float32)
        depth = self.points[:, 2].astype(np.float32)
        motion = there @ inverse(here)
        for number in np.flatnonzero(np.diff(self.first)).tolist():
            if np.array_equal(here[number], there[number]):
                continue  # exactly zero
            part = self.of_part(number)
            points = apply(motion[number], self.points[part])
            uv, depth[part] = project_in_front(self.intrinsics, points)
            np.subtract(uv, self.pixels[part], out=flow[part], casting="same_kind")
        return PointMotion(flow, depth)

    def flow_image(self, moved: PointMotion) -> NDArray[np.float32]:
        """Flow [H W 2] px; NaN where there is no surface."""
        out = self.still.copy()
        for k in (0, 1):  # faster than both at once
            out.reshape(-1, 2)[self.index, k] = moved.flow[:, k]
        return out


def project_in_front(intrinsics: Array, points_in_cam: Array) -> tuple[Array, Array]:
    """Pixels [... 2] and depth [...] m of camera-frame points [... 3] m; NaN behind the camera."""
    z = points_in_cam[..., 2]
    if (z <= 0).any():
        points_in_cam = np.where(z[..., None] > 0, points_in_cam, np.nan)
    uvz = pinhole.project(intrinsics, points_in_cam)
    return uvz[..., :2], uvz[..., 2]


def surface_points(
    depth: NDArray[np.float32], part: NDArray[np.uint16], k: Array, parts: int,
    world_moves: bool = False,
) -> SurfacePoints:
    """Points of a frame from depth [H W] m (0: no surface), part numbers [H W] in 0..parts and
    intrinsics [3 3]. Those of the world are left out unless it moves in the camera's frame.
    """
    seen = np.flatnonzero(depth > 0 if world_moves else part > 0)  # of bool: five times faster
    number = part.ravel()[seen]
    order = np.argsort(number, kind="stable")  # a radix sort; parts become slices
    index = seen[order].astype(np.int32)
    first = np.searchsorted(number[order], np.arange(parts + 2))
    v, u = np.divmod(index, np.int32(depth.shape[1]))
    pixels = np.stack([u, v], axis=1).astype(np.float64)
    points = np.asfortranarray(pinhole.unproject(k, pixels, depth.ravel()[index]))
    still = np.where(depth == 0, np.float32(np.nan), np.float32(0.0))
    flow = np.asarray(cv2.merge([still, still]), np.float32)
    return SurfacePoints(flow, index, first, pixels, points, k)


def visibility(
    points: SurfacePoints,
    moved: PointMotion,
    next_depth: NDArray[np.float32],
    next_part: NDArray[np.uint16],
    depth_unit: float,
) -> NDArray[np.uint8]:
    """Return the visibility code [H W] of each part pixel's correspondence in the next frame.

    `moved` holds the points in the next frame, whose depth [H W] m and parts [H W] follow. The
    codes are those of `Frame.visibility`; the rule is `is_seen`.
    """
    target = points.pixels + moved.flow
    number = np.repeat(np.arange(len(points.first) - 1, dtype=np.uint16), np.diff(points.first))
    seen = is_seen(target, moved.depth, number, (next_depth, next_part), depth_unit)
    answer = np.where(seen, np.uint8(VISIBLE), np.uint8(OCCLUDED))
    answer[~pinhole.inside_image(target, *next_part.shape)] = OUT_OF_IMAGE
    answer[points.of_part(0)] = BACKGROUND
    out = np.full(next_part.shape, BACKGROUND, np.uint8)
    out.ravel()[points.index] = answer
    return out


def is_seen(
    pixels: Array, z: NDArray[np.floating], number: NDArray[np.integer],
    images: tuple[NDArray[np.float32], NDArray[np.uint16]], depth_unit: float,
) -> NDArray[np.bool_]:
    """Whether a frame shows surface points [N] of parts `number` [N] at (u, v) [N 2], z [N] m.

    A point is seen if, of the four pixels around it, some show its part, and its depth lies
    between theirs, within DEPTH_TOLERANCE or two depth units. Part identity and depth decide,
    because surfaces at a silhouette are nearer to each other in the image than in space.
    `images` are the frame's depth [H W] m and part numbers [H W].
    """
    depth, part = (image.ravel() for image in images)
    shape, kind = images[0].shape, z.dtype.type
    nearest = np.full(len(z), np.inf, np.float32)
    farthest = np.full(len(z), -np.inf, np.float32)
    for pixel in pinhole.four_pixels(pixels, *shape):
        there, same = depth[pixel], part[pixel] == number
        np.minimum(nearest, there, out=nearest, where=same)
        np.maximum(farthest, there, out=farthest, where=same)
    tolerance = np.maximum(kind(2 * depth_unit), kind(DEPTH_TOLERANCE) * z)
    inside = pinhole.inside_image(pixels, *shape)
    return inside & (z >= nearest - tolerance) & (z <= farthest + tolerance)
