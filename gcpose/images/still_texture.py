"""Texture that stays where it is: a shadow passes over it, but nothing moves there."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numerics import Image
from .foreground import without_specks
from .settings import ImageSettings

_OPENING = 5  # px; window that removes thin pieces of a mask


def leave_out_still_texture(
    rgb: NDArray[np.uint8], moving: NDArray[np.bool_], settings: ImageSettings
) -> NDArray[np.bool_]:
    """Return what is taken for moving [T H W] in images [T H W 3] of a still camera, without what
    stays where it is; all of it if at most `max_still_texture` of its texture stays.

    A plain surface shows no motion: it stays if the nearest texture does.
    """
    usual, live, stays = _textures(rgb, settings)
    if _share(moving, usual, stays) <= settings.max_still_texture:
        return moving
    out, window = np.empty_like(moving), np.ones((_OPENING, _OPENING), np.uint8)
    for t, mask in enumerate(moving):
        moves = mask & live[t] & ~stays[t]
        if not moves.any():
            out[t] = False
            continue
        to_still, to_moving = (cv2.distanceTransform((~texture).astype(np.uint8), cv2.DIST_L2, 5)
                               for texture in (stays[t], moves))
        kept = (mask & (to_moving <= to_still)).astype(np.uint8)
        out[t] = without_specks(cv2.morphologyEx(kept, cv2.MORPH_OPEN, window) > 0, settings)
    return out


def still_texture_share(
    rgb: NDArray[np.uint8], moving: NDArray[np.bool_], settings: ImageSettings
) -> float:
    """Return which share of the texture in what is taken for moving [T H W] stays where it is in
    images [T H W 3] of a still camera."""
    usual, _, stays = _textures(rgb, settings)
    return _share(moving, usual, stays)


def _share(
    moving: NDArray[np.bool_], usual: NDArray[np.bool_], stays: NDArray[np.bool_]
) -> float:
    """Share of the usual texture [H W] in a mask [T H W] that stays [T H W]."""
    return float((moving & stays).sum() / max(1, (moving & usual).sum()))


def _textures(
    rgb: NDArray[np.uint8], settings: ImageSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where images [T H W 3] usually have texture [H W], where each has it, and where that
    texture stays [T H W].

    A texture stays if it correlates with its median over time, whatever the light, in most frames.
    """
    s = settings
    gray = [cv2.GaussianBlur(cv2.cvtColor(i, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0),
                             s.texture_blur) for i in rgb]
    usual = np.median(np.stack(gray), axis=0).astype(np.float32)
    mean, variance = _moments(usual, s)
    textured = variance > s.still_contrast**2
    same, live = (np.empty(rgb.shape[:3], bool) for _ in range(2))
    for t, image in enumerate(gray):
        own_mean, own_variance = _moments(image, s)
        both = _average(image * usual, s) - own_mean * mean
        same[t] = both > s.still_correlation * np.sqrt((own_variance + 1) * (variance + 1))
        live[t] = own_variance > s.still_contrast**2
    return textured, live, textured & same & (same.mean(axis=0) >= s.still_frames_share)


def _moments(image: Image, settings: ImageSettings) -> tuple[Image, Image]:
    """Return the mean and the variance around each pixel of an image [H W]."""
    mean = _average(image, settings)
    return mean, np.maximum(_average(image * image, settings) - mean * mean, 0)


def _average(values: Image, settings: ImageSettings) -> Image:
    sigma = settings.still_window
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma), np.float32)
