"""Optical flow and visibility in closed form, from depth, part numbers and poses.

A surface point that is seen at pixel x with depth z belongs to a rigid part (or to the world). Its
position in another frame follows from the part's two poses; its projection minus x is the flow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array, inverse
from .sequence import BACKGROUND, OCCLUDED, OUT_OF_IMAGE, VISIBLE

DEPTH_TOLERANCE = 0.002
"""Depths of one part that differ by less than this share of the depth are the same surface."""


def pose_table(cam_from_world: Array, world_from_part: Array) -> Array:
    """cam_from_X [T P+1 4 4] by part number: row 0 is the world, row p the part of number p.

    From cam_from_world [T 4 4] and world_from_part [T P 4 4].
    """
    world = cam_from_world[:, None]
    return np.concatenate([world, world @ world_from_part], axis=1)


def flow_to(
    depth: NDArray[np.float32], part: NDArray[np.uint16], here: Array, there: Array, k: Array
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Flow [H W 2] px from this frame to another, and each point's depth there [H W] m.

    depth [H W] m (0: no surface), part [H W], pose tables [P+1 4 4] of the two instants,
    intrinsics [3 3]. NaN where there is no surface or where the point passes behind the camera.
    """
    width = depth.shape[1]
    flow = np.zeros((*depth.shape, 2), np.float32)
    flow[depth == 0] = np.nan
    depth_there = depth.copy()
    stands = np.all(here == there, axis=(1, 2))
    moving = np.flatnonzero((~stands)[part] & (depth > 0))
    if not moving.size:
        return flow, depth_there
    number = part.ravel()[moving]
    v, u = np.divmod(moving, width)
    z = depth.ravel()[moving].astype(np.float64)
    y = (v - k[1, 2]) / k[1, 1]
    x = (u - k[0, 2] - k[0, 1] * y) / k[0, 0]
    points = np.stack([x * z, y * z, z], axis=1)
    move = there @ inverse(here)
    for row in np.flatnonzero(np.bincount(number)):
        chosen = number == row
        points[chosen] = points[chosen] @ move[row, :3, :3].T + move[row, :3, 3]
    z = np.where(points[:, 2] > 0, points[:, 2], np.nan)
    y = points[:, 1] / z
    flow.reshape(-1, 2)[moving, 0] = k[0, 0] * points[:, 0] / z + k[0, 1] * y + k[0, 2] - u
    flow.reshape(-1, 2)[moving, 1] = k[1, 1] * y + k[1, 2] - v
    depth_there.ravel()[moving] = z
    return flow, depth_there


def visibility(
    flow: NDArray[np.float32],
    depth_there: NDArray[np.float32],
    part: NDArray[np.uint16],
    next_depth: NDArray[np.float32],
    next_part: NDArray[np.uint16],
    depth_unit: float,
) -> NDArray[np.uint8]:
    """Whether each part pixel's correspondence is seen in the next frame, [H W] (sequence.py).

    A point is visible if, among the four pixels around its target, some show the same part, and
    its depth lies between theirs (give or take DEPTH_TOLERANCE or two depth units): part identity
    and depth decide, as surfaces at a silhouette are nearer to each other in the image than in
    space (lessons 7). Arguments are [H W 2] px and [H W] m of this frame and of the next.
    """
    height, width = part.shape
    out = np.full(part.shape, BACKGROUND, np.uint8)
    index = np.flatnonzero(part)
    v, u = np.divmod(index, width)
    du, dv = flow.reshape(-1, 2)[index].T.astype(np.float64)
    u, v, z = u + du, v + dv, depth_there.ravel()[index]
    inside = (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
    number = part.ravel()[index]
    left, top = np.floor(np.where(inside, u, 0)), np.floor(np.where(inside, v, 0))
    nearest = np.full(len(index), np.inf, np.float32)
    farthest = np.full(len(index), -np.inf, np.float32)
    for dy in (0, 1):
        for dx in (0, 1):
            row = np.clip(top + dy, 0, height - 1).astype(np.int64)
            pixel = row * width + np.clip(left + dx, 0, width - 1).astype(np.int64)
            same = next_part.ravel()[pixel] == number
            there = next_depth.ravel()[pixel]
            nearest = np.minimum(nearest, np.where(same, there, np.inf))
            farthest = np.maximum(farthest, np.where(same, there, -np.inf))
    tolerance = np.maximum(2.0 * depth_unit, DEPTH_TOLERANCE * z)
    seen = (z >= nearest - tolerance) & (z <= farthest + tolerance)
    out.ravel()[index] = np.where(inside, np.where(seen, VISIBLE, OCCLUDED), OUT_OF_IMAGE)
    return out
