"""Optional truth of single points over time: a model's keypoints, and tracks on its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, apply, inverse
from ...robots.model import ArticulatedModel
from ..scene import PosedModel
from ..types import Camera
from .correspondence import DEPTH_TOLERANCE
from .deforming import weights

KEYPOINT_SHARE = 0.02
"""Of the model's size: how far behind the surface that is seen a keypoint still counts as seen."""


@dataclass(frozen=True)
class View:
    """What T frames show: depth [H W] m and part numbers [H W] of each, from one camera."""

    camera: Camera
    depth: list[NDArray[np.float32]]
    part: list[NDArray[np.uint16]]
    depth_unit: float
    """m"""


@dataclass(frozen=True)
class PointPaths:
    """N points over T frames."""

    part: NDArray[np.int64]
    """[N] part number, as in the masks"""
    world: Array
    """[T N 3] m"""
    image: Array
    """[T N 2] px; NaN behind the camera"""
    visible: NDArray[np.bool_]
    """[T N]"""


def keypoint_paths(model: ArticulatedModel, world_from_part: Array, view: View, tolerance: float
                   ) -> PointPaths:
    """The model's keypoints over poses [T P 4 4].

    One is visible if it is in the image, and not more than `tolerance` m behind all four pixels
    around it: a keypoint may be inside of what it marks.
    """
    poses = world_from_part[:, model.keypoint_part]
    world = np.einsum("tkij,kj->tki", poses[..., :3, :3], model.keypoint) + poses[..., :3, 3]
    image, z = projected(view.camera, world)
    visible = np.zeros(z.shape, bool)
    for t, depth in enumerate(view.depth):
        inside, pixels = four_pixels(image[t], depth.shape)
        there = depth.ravel()[pixels]
        farthest = np.where(there > 0, there, np.inf).max(axis=0)
        visible[t] = inside & (z[t] <= farthest + tolerance)
    return PointPaths(model.keypoint_part + 1, world, image, visible)


def track_paths(
    rng: np.random.Generator, count: int, posed: PosedModel, view: View,
    face: list[NDArray[np.int32]],
) -> tuple[PointPaths, NDArray[np.int64]]:
    """Points on the model's surface over all frames, and the frame [N] at which each is chosen.

    Those frames are spread evenly over the video. In its own a point is a pixel's centre: of a
    part that is seen, all being equally likely, any pixel. There are none if no part is seen.
    `face` holds the triangle of each pixel, T x [H W], or nothing if nothing deforms.
    """
    frames = len(view.depth)
    seen = [t for t in range(frames) if (view.part[t] > 0).any()]
    if not seen:
        count = 0
    query = np.array([seen[i * len(seen) // max(count, 1)] for i in range(count)], np.int64)
    pixel, part = np.zeros((2, count), np.int64)
    for i, t in enumerate(query):
        flat = view.part[t].ravel()
        part[i] = rng.choice(np.unique(flat[flat > 0]))
        pixel[i] = rng.choice(np.flatnonzero(flat == part[i]))
    v, u = np.divmod(pixel, view.camera.width)
    k_inverse = np.linalg.inv(view.camera.intrinsics)
    z = np.array([view.depth[t].ravel()[p] for t, p in zip(query, pixel, strict=True)])
    cam = np.stack([u, v, np.ones(count)], axis=1) @ k_inverse.T * z[:, None]
    start = apply(view.camera.world_from_cam, cam)
    world = _rigid_paths(start, part, query, posed.world_from_part)
    if face:
        number = np.array([face[t].ravel()[p] for t, p in zip(query, pixel, strict=True)], np.int64)
        loose = np.flatnonzero(posed.face_deforms[number])
        world[:, loose] = _deforming_paths(
            start[loose], posed.faces[number[loose]], query[loose], posed, view.camera)
    image, z = projected(view.camera, world)
    visible = np.stack([
        surface_visible(image[t], z[t], part, view.depth[t], view.part[t], view.depth_unit)
        for t in range(frames)])
    return PointPaths(part, world, image, visible), query


def _rigid_paths(start: Array, part: NDArray[np.int64], query: NDArray[np.int64],
                 world_from_part: Array) -> Array:
    """[T N 3] of points `start` [N 3] m (world, each at its query frame) that ride on parts."""
    at_query = world_from_part[query, part - 1]
    local = np.einsum("nij,nj->ni", inverse(at_query)[:, :3, :3], start)
    local += inverse(at_query)[:, :3, 3]
    poses = world_from_part[:, part - 1]
    return np.einsum("tnij,nj->tni", poses[..., :3, :3], local) + poses[..., :3, 3]


def _deforming_paths(start: Array, corners: NDArray[np.int64], query: NDArray[np.int64],
                     posed: PosedModel, camera: Camera) -> Array:
    """[T N 3] of points that keep their place in triangles whose corners deform, [N 3]."""
    share = np.zeros((len(start), 3))
    offset = np.zeros((len(start), 3))
    for t in np.unique(query):
        now = query == t
        here = posed.vertices(int(t))[corners[now]]
        rays = apply(camera.cam_from_world, start[now])
        share[now] = weights(rays, apply(camera.cam_from_world, here))
        # What a rasterizer's rounding moves a point off its triangle stays with it.
        offset[now] = start[now] - np.einsum("nk,nki->ni", share[now], here)
    frames = range(len(posed.world_from_part))
    return np.stack([
        np.einsum("nk,nki->ni", share, posed.vertices(t)[corners]) + offset for t in frames])


def projected(camera: Camera, world: Array) -> tuple[Array, Array]:
    """Pixels [T N 2] (NaN behind the camera) and depth [T N] m of points [T N 3] m."""
    cam = apply(camera.cam_from_world, world)
    z = cam[..., 2]
    uvw = cam @ camera.intrinsics.T
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(z[..., None] > 0, uvw[..., :2] / uvw[..., 2:], np.nan), z


def surface_visible(
    image: Array, z: Array, number: NDArray[np.int64], depth: NDArray[np.float32],
    part: NDArray[np.uint16], depth_unit: float,
) -> NDArray[np.bool_]:
    """[N] whether surface points at pixels [N 2] and depth [N] m, of part numbers [N], are seen in
    a frame: by the rule of visibility images (flow.py).
    """
    inside, pixels = four_pixels(image, depth.shape)
    same, there = part.ravel()[pixels] == number, depth.ravel()[pixels].astype(np.float64)
    nearest = np.where(same, there, np.inf).min(axis=0)
    farthest = np.where(same, there, -np.inf).max(axis=0)
    tolerance = np.maximum(2 * depth_unit, DEPTH_TOLERANCE * z)
    return inside & (z >= nearest - tolerance) & (z <= farthest + tolerance)


def four_pixels(image: Array, shape: tuple[int, ...]) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """[N] whether points at pixels [N 2] are in an image [H W], and the flat index [4 N] of the
    pixels around them (at the border, of the nearest ones).
    """
    height, width = shape
    u, v = image.T
    with np.errstate(invalid="ignore"):
        inside = (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
    u, v = (np.floor(np.where(inside, x, 0.0)).astype(np.intp) for x in (u, v))
    columns = [np.clip(u + du, 0, width - 1) for du in (0, 1)]
    rows = [np.clip(v + dv, 0, height - 1) for dv in (0, 1)]
    return inside, np.stack([row * width + column for row in rows for column in columns])
