"""Noise of a camera and of a codec, without which only what moves changes in a video."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numerics import Image
from .settings import ImageSettings

_STRIDE = 3  # px from one pixel to the next of those whose changes show the noise
_EXPOSED = (4, 251)  # grey levels between which noise is not cut off


def remove_camera_noise(rgb: NDArray[np.uint8], settings: ImageSettings) -> NDArray[np.uint8]:
    """Return images [T H W 3] of a still camera in which what does not move does not change.

    Noise is told from motion by its size and its extent, by hysteresis as edges are by Canny
    (1986): a region moves if its pixels change by more than noise does, and some of them by much
    more. All other pixels get their median over time. A video without noise stays as it is.
    """
    some, median = median_image(rgb, settings)
    smooth = blur_image(median, settings)
    coarse = (slice(None, None, _STRIDE),) * 2
    noise = still_change(np.stack([blur_image(i, settings)[coarse] for i in some]),
                         smooth[coarse], settings)
    if noise == 0:
        return rgb

    out = rgb.copy()
    for image in out:
        change = np.asarray(np.abs(blur_image(image, settings) - smooth).max(axis=2))
        still = ~moving_regions(change, noise, settings.min_strong, settings)
        image[still] = median[still]
    return out


def moving_regions(
    change: Image, noise: float, least: int, settings: ImageSettings
) -> NDArray[np.bool_]:
    """Return the pixels [H W] of regions that change by more than noise does, grey levels, and of
    which at least so many pixels change strongly."""
    s = settings
    weak, strong = (fixed + growth * noise for fixed, growth in (s.weak_change, s.strong_change))
    count, found = cv2.connectedComponents((change > weak).astype(np.uint8))
    region = np.asarray(found, np.int64)
    moves = np.bincount(region[change > strong], minlength=count) >= least
    moves[0] = False
    return np.asarray(moves[region])


def many_pixels_change(rgb: NDArray[np.uint8], settings: ImageSettings) -> bool:
    """Return whether so few exposed pixels of images [T H W 3] stay the same that not only an
    object moves: the camera, its exposure, or noise changes the others."""
    images = rgb[:, ::_STRIDE, ::_STRIDE]
    _, median = median_image(images, settings)
    exposed = ((median > _EXPOSED[0]) & (median < _EXPOSED[1])).all(axis=2)
    still = (images == median).all(axis=(0, 3))[exposed]
    return bool(len(still) and still.mean() <= settings.noise_shares[-1])


def still_change(images: Image, median: Image, settings: ImageSettings) -> float:
    """Return by how many grey levels a pixel that does not move changes at most, in the median.

    images [T H W 3] are compared with their median [H W 3]. The result is 0 where most pixels
    move, or where many do not change at all.
    """
    exposed = ((median > _EXPOSED[0]) & (median < _EXPOSED[1])).all(axis=2)
    if not exposed.any():
        return 0.0
    change = np.abs(images - median).max(axis=(0, 3))[exposed]
    quantiles = [float(q) for q in np.quantile(change, settings.noise_shares)]
    small = [q for q in quantiles if q <= settings.max_noise]
    noise = small[0] if small else quantiles[-1]
    return noise if noise <= settings.most_noise and quantiles[-1] > 0 else 0.0


def median_image(
    rgb: NDArray[np.uint8], settings: ImageSettings
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return at most `foreground_frames` of images [T H W 3], and their median [H W 3]."""
    count = min(len(rgb), settings.foreground_frames)
    some = rgb[np.linspace(0, len(rgb) - 1, count).astype(int)]
    middle = len(some) // 2
    return some, np.partition(some, middle, axis=0)[middle]


def blur_image(image: NDArray[np.uint8], settings: ImageSettings) -> Image:
    """Return an image [H W 3] in which noise is smaller."""
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), settings.noise_blur)
    return np.asarray(blurred, np.float32)
