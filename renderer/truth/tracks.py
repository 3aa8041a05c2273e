"""Optional truth of points over time: a model's keypoints, and tracks on its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, apply, inverse, pinhole
from ...robots.model import ArticulatedModel
from ..scene import PosedModel
from ..types import Camera
from .correspondence import is_seen, project_in_front
from .deforming import weights

KEYPOINT_SHARE = 0.02
"""Share of the model's size by which a visible keypoint may lie behind the visible surface."""


@dataclass(frozen=True)
class TruthImages:
    """Depth [H W] m and part numbers [H W] of T frames."""

    cameras: tuple[Camera, ...]
    """of each frame"""
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


def keypoint_paths(
    model: ArticulatedModel, world_from_part: Array, images: TruthImages, tolerance: float
) -> PointPaths:
    """Return the paths of the model's keypoints over poses [T P 4 4].

    A keypoint is visible if it is in the image and at most `tolerance` m behind the farthest of
    the four pixels around it, because it may lie inside the surface that it marks.
    """
    poses = world_from_part[:, model.keypoint_part]
    world = np.einsum("tkij,kj->tki", poses[..., :3, :3], model.keypoint) + poses[..., :3, 3]
    image, z = _project(images.cameras, world)
    visible = np.zeros(z.shape, bool)
    for t, depth in enumerate(images.depth):
        there = depth.ravel()[pinhole.four_pixels(image[t], *depth.shape)]
        farthest = np.where(there > 0, there, np.inf).max(axis=0)
        inside = pinhole.inside_image(image[t], *depth.shape)
        visible[t] = inside & (z[t] <= farthest + tolerance)
    return PointPaths(model.keypoint_part + 1, world, image, visible)


def track_paths(
    rng: np.random.Generator, count: int, world_from_part: Array, images: TruthImages,
    deforming: tuple[PosedModel, list[NDArray[np.int32]]] | None = None,
) -> tuple[PointPaths, NDArray[np.int64]]:
    """Choose N points on a model's surface; return their paths and their query frames [N].

    Each point is the center of a pixel in its query frame. Query frames are spread evenly over
    the frames that show a part; there all visible parts are equally likely, and then all pixels
    of the part. N is `count`, or 0 if no part is ever visible. Parts are in poses [T P 4 4]; where
    surfaces deform, the posed model and each frame's triangles [H W] (-1: none) are needed.
    """
    seen = [t for t, part in enumerate(images.part) if (part > 0).any()]
    if not seen:
        count = 0
    query = np.array([seen[i * len(seen) // max(count, 1)] for i in range(count)], np.int64)
    pixel, part = np.zeros((2, count), np.int64)
    for i, t in enumerate(query):
        flat = images.part[t].ravel()
        part[i] = rng.choice(np.unique(flat[flat > 0]))
        pixel[i] = rng.choice(np.flatnonzero(flat == part[i]))
    first = images.cameras[0]
    v, u = np.divmod(pixel, first.width)
    z = np.array([images.depth[t].ravel()[p] for t, p in zip(query, pixel, strict=True)])
    # By the inverse matrix, not by `pinhole.unproject`: points of parts that stand still lie at
    # pixel centers, where the last bit decides which four pixels are around them, and so what is
    # visible. This keeps sequences equal to those of earlier versions.
    k_inverse = np.linalg.inv(first.intrinsics)
    cam = np.stack([u, v, np.ones(count)], axis=1) @ k_inverse.T * z[:, None]
    start = np.zeros_like(cam)
    for camera in {id(camera): camera for camera in images.cameras}.values():
        own = np.array([images.cameras[t] is camera for t in query], bool)
        start[own] = apply(camera.world_from_cam, cam[own])
    world = _rigid_paths(start, part, query, world_from_part)
    if deforming is not None:
        posed, face = deforming
        number = np.array([face[t].ravel()[p] for t, p in zip(query, pixel, strict=True)], np.int64)
        loose = np.flatnonzero(posed.face_deforms[number])
        world[:, loose] = _deforming_paths(
            start[loose], posed.faces[number[loose]], query[loose], posed, images.cameras)
    image, z = _project(images.cameras, world)
    visible = np.array([
        is_seen(image[t], z[t], part, (depth, number), images.depth_unit)
        for t, (depth, number) in enumerate(zip(images.depth, images.part, strict=True))], bool)
    return PointPaths(part, world, image, visible.reshape(z.shape)), query


def _rigid_paths(start: Array, part: NDArray[np.int64], query: NDArray[np.int64],
                 world_from_part: Array) -> Array:
    """[T N 3] of points `start` [N 3] m (world, each at its query frame) that ride on parts."""
    at_query = world_from_part[query, part - 1]
    local = np.einsum("nij,nj->ni", inverse(at_query)[:, :3, :3], start)
    local += inverse(at_query)[:, :3, 3]
    poses = world_from_part[:, part - 1]
    return np.einsum("tnij,nj->tni", poses[..., :3, :3], local) + poses[..., :3, 3]


def _deforming_paths(start: Array, corners: NDArray[np.int64], query: NDArray[np.int64],
                     posed: PosedModel, cameras: tuple[Camera, ...]) -> Array:
    """[T N 3] of points that keep their place in triangles whose corners deform, [N 3]."""
    share = np.zeros((len(start), 3))
    offset = np.zeros((len(start), 3))
    for t in np.unique(query):
        now = query == t
        here = posed.vertices(int(t))[corners[now]]
        cam_from_world = cameras[t].cam_from_world
        rays = apply(cam_from_world, start[now])
        share[now] = weights(rays, apply(cam_from_world, here))
        # What a rasterizer's rounding moves a point off its triangle stays with it.
        offset[now] = start[now] - np.einsum("nk,nki->ni", share[now], here)
    frames = range(len(posed.world_from_part))
    return np.stack([
        np.einsum("nk,nki->ni", share, posed.vertices(t)[corners]) + offset for t in frames])


def _project(cameras: tuple[Camera, ...], world: Array) -> tuple[Array, Array]:
    """Pixels [T N 2] (NaN behind the camera) and depth [T N] m of points [T N 3] m."""
    cam = apply(np.stack([camera.cam_from_world for camera in cameras]), world)
    return project_in_front(cameras[0].intrinsics, cam)[0], cam[..., 2]
