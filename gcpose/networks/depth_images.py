"""Depth images as the learned baselines see them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DEPTH_WIDTH, DEPTH_HEIGHT = 192, 108
"""Size of the depth images, px."""
_DEPTH_UNIT = 12.0  # m


def fit_depth(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return depth images [T H W] m as the networks see them [T 108 192], in units of 12 m.

    They are reduced as a whole, by the nearest pixel, with zeros beside them.
    """
    height, width = depth.shape[1:]
    factor = min(DEPTH_WIDTH / width, DEPTH_HEIGHT / height)
    w, h = max(1, round(width * factor)), max(1, round(height * factor))
    rows = ((np.arange(h) + 0.5) * height / h).astype(np.int64)
    columns = ((np.arange(w) + 0.5) * width / w).astype(np.int64)
    top, left = (DEPTH_HEIGHT - h) // 2, (DEPTH_WIDTH - w) // 2
    out = np.zeros((len(depth), DEPTH_HEIGHT, DEPTH_WIDTH), np.float32)
    out[:, top : top + h, left : left + w] = depth[:, rows[:, None], columns]
    out /= np.float32(_DEPTH_UNIT)
    return out
