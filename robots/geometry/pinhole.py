"""The pinhole camera: OpenCV axes (x right, y down, z forward), pixel centers at integers.

Intrinsics are [3 3] px with the skew at [0, 1]; the center of the top-left pixel is (0, 0).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .transforms import Array


def project(intrinsics: Array, points_in_cam: ArrayLike) -> Array:
    """(u, v, z) [... 3] of camera-frame points [... 3]: pixels, pixels, metres."""
    p = np.asarray(points_in_cam, np.float64)
    z = p[..., 2]
    uv = p @ intrinsics[:2].T / z[..., None]
    return np.concatenate([uv, z[..., None]], axis=-1)


def pixel_rays(intrinsics: Array, pixels: ArrayLike) -> Array:
    """The points [... 3] at depth 1 that pixels (u, v) [... 2] show."""
    p = np.asarray(pixels, np.float64)
    k = intrinsics
    y = (p[..., 1] - k[1, 2]) / k[1, 1]
    x = (p[..., 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def unproject(intrinsics: Array, pixels: ArrayLike, depth: ArrayLike) -> Array:
    """The camera-frame points [... 3] m that pixels (u, v) [... 2] show at `depth` [...] m."""
    return pixel_rays(intrinsics, pixels) * np.asarray(depth, np.float64)[..., None]


def pixel_grid(height: int, width: int) -> Array:
    """(u, v) [H W 2] of every pixel of an image."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float64)


def inside_image(pixels: Array, height: int, width: int) -> NDArray[np.bool_]:
    """[...] whether positions (u, v) [... 2] lie on an image's pixels, which reach half a pixel
    about their centers; NaN does not.
    """
    u, v = pixels[..., 0], pixels[..., 1]
    with np.errstate(invalid="ignore"):
        return (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)


def four_pixels(pixels: Array, height: int, width: int) -> NDArray[np.intp]:
    """Flat indices [4 N] of the pixels about positions (u, v) [N 2].

    The order is top left, top right, bottom left, bottom right. Beyond the border the nearest
    pixels take the place of those that are missing. Positions that are not `inside_image` give
    the pixels of (0, 0).
    """
    inside = inside_image(pixels, height, width)
    u, v = (np.floor(np.where(inside, pixels[:, k], 0.0)).astype(np.intp) for k in (0, 1))
    columns = np.maximum(u, 0), np.minimum(u + 1, width - 1)
    rows = np.maximum(v, 0) * width, np.minimum(v + 1, height - 1) * width
    out = np.empty((4, len(pixels)), np.intp)
    for k in range(4):
        np.add(rows[k // 2], columns[k % 2], out=out[k])
    return out
