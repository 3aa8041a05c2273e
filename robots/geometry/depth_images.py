"""Depth images as the learned baselines, and the published code of ScrewNet, see them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .transforms import Array

DEPTH_WIDTH, DEPTH_HEIGHT = 192, 108
"""Size of the depth images, px."""
_DEPTH_UNIT = 12.0  # m


def fit_depth(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return depth images [T H W] m as the networks see them [T 108 192], in units of 12 m.

    They are reduced as a whole, by the nearest pixel, with zeros beside them.
    """
    height, width = depth.shape[1:]
    w, h, left, top = _place(width, height)
    rows = ((np.arange(h) + 0.5) * height / h).astype(np.int64)
    columns = ((np.arange(w) + 0.5) * width / w).astype(np.int64)
    out = np.zeros((len(depth), DEPTH_HEIGHT, DEPTH_WIDTH), np.float32)
    out[:, top : top + h, left : left + w] = depth[:, rows[:, None], columns]
    out /= np.float32(_DEPTH_UNIT)
    return out


def fit_intrinsics(intrinsics: Array, width: int, height: int) -> Array:
    """Return the intrinsics [3 3] of images of `fit_depth`, of those of images of a size."""
    w, h, left, top = _place(width, height)
    x, y = w / width, h / height
    fit = np.array([[x, 0.0, left + (x - 1) / 2], [0.0, y, top + (y - 1) / 2], [0.0, 0.0, 1.0]])
    return fit @ intrinsics


def _place(width: int, height: int) -> tuple[int, int, int, int]:
    """Width, height, left and top of an image of a size within the networks' image, px."""
    factor = min(DEPTH_WIDTH / width, DEPTH_HEIGHT / height)
    w, h = max(1, round(width * factor)), max(1, round(height * factor))
    return w, h, (DEPTH_WIDTH - w) // 2, (DEPTH_HEIGHT - h) // 2
