"""Where the outline of a foreground can be trusted: where it stands out from the background.

A mask is right to a pixel where what moves differs from the background beside it. Where both look
alike, or where the background is never seen, the mask is a guess, and its outline may stay while
the object moves.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numerics import Image
from .settings import ImageSettings

_WINDOW = (5, 5)  # px around an outline whose colors are compared


def sharp_outlines(
    rgb: NDArray[np.uint8], moving: NDArray[np.bool_], settings: ImageSettings
) -> NDArray[np.bool_]:
    """Return where [T h w] an outline of the foreground [T h w] of images [T h w 3] is sharp.

    There, the foreground differs from the background, and what is beside it does not. The
    background of a pixel is its color in the frame in which it is farthest from the foreground.
    """
    away = np.stack([np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, 5))
                     for mask in (~moving).astype(np.uint8)])
    best = away.argmax(axis=0)[None]
    background = np.take_along_axis(rgb, best[..., None], axis=0)[0]
    known = np.take_along_axis(away, best, axis=0)[0] >= settings.sharp_distance
    out = np.empty(moving.shape, bool)
    for t, (image, mask) in enumerate(zip(rgb, moving, strict=True)):
        apart = cv2.absdiff(image, background).max(axis=2).astype(np.float32)
        share = mask.astype(np.float32)
        inside, outside = _mean_near(apart, share), _mean_near(apart, 1 - share)
        out[t] = known & (inside >= settings.sharp_contrast) & (outside <= settings.sharp_rest)
    return out


def _mean_near(values: Image, weight: Image) -> Image:
    """Weighted means [h w] around each pixel; 0 where all weights are 0."""
    total, weights = cv2.blur(values * weight, _WINDOW), cv2.blur(weight, _WINDOW)
    return np.asarray(total / np.maximum(1e-3, weights), np.float32)
