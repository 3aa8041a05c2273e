"""Where moved points meet an image, and what it shows there."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array
from .compiled import Number, compiled
from .surface import Image

Matrix = tuple[Number, ...]
"""The upper three rows of a motion."""
Camera = tuple[Number, Number, Number, Number, Number, Number]
"""Focal lengths, principal point, width and height, px."""

NEAR = np.float32(1e-3)  # m, before the camera


def camera_of(intrinsics: Array, depth: Image) -> Camera:
    """What the loops know of the camera of depth images [... H W]."""
    k, (height, width) = intrinsics, depth.shape[-2:]
    numbers = (k[0, 0], k[1, 1], k[0, 2], k[1, 2], width, height)
    return cast(Camera, tuple(np.float32(n) for n in numbers))


def columns(*arrays: Array) -> Image:
    """[C N] in single precision: the columns of arrays [N c] and [N], one after another."""
    return np.ascontiguousarray(np.column_stack(arrays).T, np.float32)


@compiled
def matrix_of(m: Image) -> Matrix:
    """Of a motion [4 4]."""
    return (m[0, 0], m[0, 1], m[0, 2], m[0, 3], m[1, 0], m[1, 1], m[1, 2], m[1, 3],
            m[2, 0], m[2, 1], m[2, 2], m[2, 3])


@compiled
def moved(m: Matrix, x: Number, y: Number, z: Number) -> tuple[Number, Number, Number]:
    """A point under a motion."""
    return (
        m[0] * x + m[1] * y + m[2] * z + m[3],
        m[4] * x + m[5] * y + m[6] * z + m[7],
        m[8] * x + m[9] * y + m[10] * z + m[11],
    )


@compiled
def turned(m: Matrix, x: Number, y: Number, z: Number) -> tuple[Number, Number, Number]:
    """A direction under a motion."""
    return (
        m[0] * x + m[1] * y + m[2] * z,
        m[4] * x + m[5] * y + m[6] * z,
        m[8] * x + m[9] * y + m[10] * z,
    )


class Sight(NamedTuple):
    """Where N moved points meet an image, and what it shows there."""

    x: Image
    y: Image
    z: Image
    """m, at least `NEAR`"""
    u: Image
    v: Image
    """px"""
    pixel: NDArray[np.uint32]
    """In a flat image; of the nearest where the image has none."""
    inside: NDArray[np.bool_]
    depth: Image
    normal_x: Image
    normal_y: Image
    normal_z: Image


@compiled
def sight_of(n: int) -> Sight:
    """Room for one."""
    f = np.float32
    return Sight(
        np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f),
        np.empty(n, np.uint32), np.empty(n, np.bool_),
        np.empty(n, f), np.empty(n, f), np.empty(n, f), np.empty(n, f),
    )


@compiled
def look(
    sight: Sight, m: Matrix, camera: Camera, point: Image, depth: Image, normal: Image
) -> None:
    """Fill in the sight of points [3.. N] in a depth image and its normals, both flat."""
    px, py, pz = point[0], point[1], point[2]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    right, bottom = camera[4] - np.float32(1), camera[5] - np.float32(1)
    wide, nil = np.int32(camera[4]), np.float32(0)
    for i in range(len(px)):
        x, y, z = moved(m, px[i], py[i], pz[i])
        z = max(z, NEAR)
        u, v = fx * x / z + cx, fy * y / z + cy
        sight.x[i], sight.y[i], sight.z[i] = x, y, z
        sight.u[i], sight.v[i] = u, v
        u, v = np.rint(u), np.rint(v)
        sight.inside[i] = (u >= 0) & (u <= right) & (v >= 0) & (v <= bottom)
        column, line = np.int32(min(max(u, nil), right)), np.int32(min(max(v, nil), bottom))
        sight.pixel[i] = np.uint32(line * wide + column)
    for i in range(len(px)):
        at = sight.pixel[i]
        sight.depth[i] = depth[at]
        sight.normal_x[i], sight.normal_y[i] = normal[3 * at], normal[3 * at + 1]
        sight.normal_z[i] = normal[3 * at + 2]


@compiled
def pixel_of(u: Number, v: Number, camera: Camera) -> tuple[np.uint32, bool]:
    """Where a pixel is in a flat image, and whether the image has it; else of the nearest."""
    right, bottom = camera[4] - np.float32(1), camera[5] - np.float32(1)
    inside = (u >= 0) & (u <= right) & (v >= 0) & (v <= bottom)
    column = np.int32(min(max(u, np.float32(0)), right))
    line = np.int32(min(max(v, np.float32(0)), bottom))
    return np.uint32(line * np.int32(camera[4]) + column), inside
