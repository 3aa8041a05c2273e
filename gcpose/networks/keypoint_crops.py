"""Crops that a keypoint network sees, and the positions in its heat maps."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, pinhole
from .torch_runtime import unit_range

CROP = 256
"""Side of a crop, px."""
MAP = 64
"""Side of a heat map, cells."""
_MARGIN = 1.5  # side of a crop, in sides of the box of the keypoints
_CELL = CROP / MAP  # px
_SIGMA = 1.0  # of the Gaussian about a keypoint, cells
_CLOSE = 0.2  # PCK: largest error of a keypoint, in sides of the box of the keypoints


def place_crop(center: Array, side: float, turn: float = 0.0) -> Array:
    """Return image_from_crop [2 3] of a square: center (u, v) px, side px, turn rad."""
    c, s = np.cos(turn), np.sin(turn)
    linear = side / CROP * np.array([[c, -s], [s, c]])
    return np.column_stack([linear, center - linear @ np.full(2, (CROP - 1) / 2)])


def frame_keypoints(pixels: Array) -> tuple[Array, float]:
    """Return center [2] and side of the square crop about positions [K 2] px, some may be NaN."""
    low, high = np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)
    return (low + high) / 2, max(_MARGIN * float((high - low).max()), 8.0)


def cut_crop(image: NDArray[np.uint8], image_from_crop: Array) -> NDArray[np.uint8]:
    """Return the crop [256 256 3] of an image [H W 3], black outside; smoothed if it shrinks."""
    factor = float(np.hypot(*image_from_crop[:, 0]))
    if factor > 1.0:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.4 * factor), np.uint8)
    return np.asarray(cv2.warpAffine(image, image_from_crop, (CROP, CROP),
                                     flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP), np.uint8)


def network_input(crop: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return a crop [256 256 3] as a batch of one [1 3 256 256], 0..1."""
    return np.ascontiguousarray(np.moveaxis(unit_range(crop), 2, 0)[None])


def keypoint_errors(found: Array, true: Array) -> tuple[Array, Array]:
    """Return the errors [K] px of positions [K 2] px, and 1 where PCK counts the keypoint, else 0.

    An error is NaN where the truth is unknown.
    """
    error = np.linalg.norm(found - true, axis=1)
    known = true[np.isfinite(true).all(axis=1)]
    box = float(np.ptp(known, axis=0).max()) if len(known) else 0.0
    return error, (error <= _CLOSE * box).astype(np.float64)


def to_image(image_from_crop: Array, positions: Array) -> Array:
    """Return image positions [... 2] px of crop positions [... 2] px."""
    return positions @ image_from_crop[:, :2].T + image_from_crop[:, 2]


def to_crop(image_from_crop: Array, pixels: Array) -> Array:
    """Return crop positions [... 2] px of image positions [... 2] px."""
    return (pixels - image_from_crop[:, 2]) @ np.linalg.inv(image_from_crop[:, :2]).T


def draw_maps(positions: Array) -> NDArray[np.float32]:
    """Return a Gaussian of height 1 and sigma 1 [K 64 64] at each crop position [K 2] px.

    A map is zero where the position is NaN or outside the crop.
    """
    cells = (positions + 0.5) / _CELL - 0.5
    there = pinhole.inside_image(cells, MAP, MAP)
    cells = np.where(there[:, None], cells, 0.0)
    axis = np.arange(MAP)
    u, v = (np.exp(-0.5 * ((axis - cells[:, k, None]) / _SIGMA) ** 2) for k in (0, 1))
    return (there[:, None, None] * v[:, :, None] * u[:, None, :]).astype(np.float32)


def find_peaks(maps: NDArray[np.float32]) -> tuple[Array, Array]:
    """Return the crop positions [... 2] px and the heights [...] of the peaks of maps [... 64 64].

    Between cells, a position is the peak of the Gaussian through the neighboring cells.
    """
    flat = maps.reshape(-1, MAP, MAP).astype(np.float64)
    each = np.arange(len(flat))
    v, u = np.unravel_index(flat.reshape(len(flat), -1).argmax(axis=1), (MAP, MAP))
    log = np.log(np.maximum(flat, 1e-6))
    place = np.stack([u, v], axis=-1).astype(np.float64)
    for k, (dv, du) in enumerate(((0, 1), (1, 0))):
        inside = (u >= du) & (u < MAP - du) & (v >= dv) & (v < MAP - dv)
        x, y = np.where(inside, u, 1), np.where(inside, v, 1)
        before, here, after = (log[each, y + s * dv, x + s * du] for s in (-1, 0, 1))
        bend = 2 * here - before - after
        shift = np.where(inside & (bend > 1e-9), (after - before) / (2 * np.maximum(bend, 1e-9)), 0)
        place[:, k] += np.clip(shift, -0.5, 0.5)
    score = flat.max(axis=(1, 2))
    shape = maps.shape[:-2]
    return ((place + 0.5) * _CELL - 0.5).reshape(*shape, 2), score.reshape(shape)
