"""Texture that stays where it is: a shadow passes over it, but nothing moves there."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numerics import Image
from .settings import ImageSettings


def still_texture_share(
    rgb: NDArray[np.uint8], moving: NDArray[np.bool_], settings: ImageSettings
) -> float:
    """Return which share of the texture in what is taken for moving [T H W] stays where it is in
    images [T H W 3] of a still camera.

    A texture stays if it correlates with its median over time, whatever the light, in most frames.
    """
    s = settings
    gray = [cv2.GaussianBlur(cv2.cvtColor(i, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0),
                             s.texture_blur) for i in rgb]
    usual = np.median(np.stack(gray), axis=0).astype(np.float32)
    mean, variance = _moments(usual, s)
    textured = variance > s.still_contrast**2
    same = np.empty(moving.shape, bool)
    for found, image in zip(same, gray, strict=True):
        own_mean, own_variance = _moments(image, s)
        both = _average(image * usual, s) - own_mean * mean
        found[:] = both > s.still_correlation * np.sqrt((own_variance + 1) * (variance + 1))
    stays = same & (same.mean(axis=0) >= s.still_frames_share)
    return float((moving & textured & stays).sum() / max(1, (moving & textured).sum()))


def _moments(image: Image, settings: ImageSettings) -> tuple[Image, Image]:
    """Return the mean and the variance around each pixel of an image [H W]."""
    mean = _average(image, settings)
    return mean, np.maximum(_average(image * image, settings) - mean * mean, 0)


def _average(values: Image, settings: ImageSettings) -> Image:
    sigma = settings.still_window
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma), np.float32)
