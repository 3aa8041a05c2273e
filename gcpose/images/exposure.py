"""Exposure and white balance of a camera, whose changes look like motion of the whole image."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image, thread_map
from .camera_noise import blur_image, many_pixels_change, median_image
from .settings import ImageSettings

_STRIDE = 3  # px from one pixel to the next of those that are compared
_EXPOSED = (5, 249)  # grey levels between which the tone is known
_MIN_PIXELS = 200
_LEAST_WHITE = 64  # grey levels that become white at most
_LEVELS = np.arange(256)
_RATIO_STEP, _MAX_RATIO = 0.004, 1.0  # of a histogram of logarithms
_OFFSET_STEP, _MAX_OFFSET = 0.5, 80.0  # of a histogram of grey levels
_OFFSETS = np.arange(-_MAX_OFFSET, _MAX_OFFSET + _OFFSET_STEP / 2, _OFFSET_STEP)


def equalize_exposure(rgb: NDArray[np.uint8], settings: ImageSettings) -> NDArray[np.uint8]:
    """Return images [T H W 3] of a still camera with one exposure; a video of constant exposure
    stays as it is."""
    table = find_tones(rgb, settings)
    return rgb if table is None else apply_tones(rgb, table)


def apply_tones(rgb: NDArray[np.uint8], table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return images [T H W 3] with other grey levels: `table` [T 256 3] tells them."""
    return np.stack([np.asarray(cv2.LUT(np.ascontiguousarray(image), t[None]), np.uint8)
                     for image, t in zip(rgb, table, strict=True)])


def find_tones(rgb: NDArray[np.uint8], settings: ImageSettings) -> NDArray[np.uint8] | None:
    """Return the levels [T 256 3] that give images [T H W 3] of a still camera one exposure; None
    if it is constant.

    Each channel of each frame gets the tone curve (Mann and Picard, "Being undigital with digital
    cameras", 1995) with which most of its pixels become those of the median over time. Then all
    are brightened until what is cut off in any frame is white in each.
    """
    if not many_pixels_change(rgb, settings):
        return None
    _, median = median_image(rgb, settings)
    usual, exposed = _levels(median, settings)

    def curves(image: NDArray[np.uint8]) -> Array:
        """Return the tone curves [256 3] of a frame."""
        levels, known = _levels(image, settings)
        known &= exposed
        return np.stack([tone_curve(levels[..., c][k], usual[..., c][k], settings)
                         for c, k in enumerate(np.moveaxis(known, 2, 0))], axis=1)

    tone = np.stack(thread_map(curves, rgb))
    present = np.stack([np.bincount(median[..., c].ravel(), minlength=256) for c in range(3)], 1)
    change = (np.abs(tone - _LEVELS[:, None]) * present).sum(axis=1) / present.sum(axis=0)
    if change.max() < settings.min_exposure_change:
        return None
    white = tone[:, _EXPOSED[1]].min(axis=0).clip(_LEAST_WHITE, 255)
    return np.rint(255 * (tone / white).clip(0, 1)).astype(np.uint8)


def tone_curve(levels: Image, usual: Image, settings: ImageSettings) -> Array:
    """Return the tone [256] of each grey level with which most `levels` [N] become `usual` [N].

    It is a factor and a smooth correction, fitted robustly, as what moves has other levels.
    """
    if len(levels) < _MIN_PIXELS:
        return _LEVELS.astype(np.float64)
    x, y = levels.astype(np.float64), usual.astype(np.float64)
    gain = float(np.exp(_mode(np.log(y / x))))
    offset = np.rint((y - gain * x + _MAX_OFFSET) / _OFFSET_STEP).astype(np.int64)
    near = (offset >= 0) & (offset < len(_OFFSETS))
    cell = np.rint(x[near]).astype(np.int64) * len(_OFFSETS) + offset[near]
    share = np.bincount(cell, minlength=256 * len(_OFFSETS)).reshape(256, -1) / max(1, near.sum())
    knots = settings.exposure_knots
    place = np.linspace(0, knots - 1, 256)
    basis = np.maximum(0, 1 - np.abs(place[:, None] - np.arange(knots)))
    bend = np.diff(np.eye(knots), 2, axis=0)
    bends, ridge = settings.exposure_smoothness * bend.T @ bend, settings.exposure_ridge
    found = np.zeros(256)
    for scale in settings.exposure_scales:
        weight = share / (1 + ((_OFFSETS - found[:, None]) / scale) ** 2) ** 2
        prior = scale**2 * bends + ridge * np.eye(knots)
        normal = basis.T @ (weight.sum(axis=1)[:, None] * basis) + prior
        found = basis @ np.linalg.solve(normal, basis.T @ (weight @ _OFFSETS))
    return np.maximum.accumulate(gain * _LEVELS + found)


def _levels(
    image: NDArray[np.uint8], settings: ImageSettings
) -> tuple[Image, NDArray[np.bool_]]:
    """Return blurred levels [h w 3] of an image, and where none of what is blurred is cut off."""
    cut = ((image < _EXPOSED[0]) | (image > _EXPOSED[1])).astype(np.uint8)
    reach = 2 * round(3 * settings.noise_blur) + 1
    near = cv2.dilate(cut, np.ones((reach, reach), np.uint8)) > 0
    coarse = (slice(None, None, _STRIDE),) * 2
    return blur_image(image, settings)[coarse], ~near[coarse]


def _mode(ratio: Array) -> float:
    """Return the most frequent of logarithms of ratios [N]."""
    edges = np.arange(-_MAX_RATIO - _RATIO_STEP / 2, _MAX_RATIO + _RATIO_STEP, _RATIO_STEP)
    count = np.histogram(ratio, edges)[0].astype(np.float32)
    best = int(cv2.GaussianBlur(count[None], (0, 0), 2.0).argmax())
    middle = (edges[best] + edges[best + 1]) / 2
    near = np.abs(ratio - middle) < 3 * _RATIO_STEP
    return float(np.median(ratio[near])) if near.any() else 0.0
