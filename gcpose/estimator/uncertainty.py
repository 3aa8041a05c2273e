"""The reported standard deviation: two thirds of the errors lie within it."""

from __future__ import annotations

import numpy as np

from ...robots.geometry import Array


def calibrate_deviation(formal: Array, factor: float, floor: Array | float, most: float) -> Array:
    """Return standard deviations [T J] for formal ones [T-1 J] of frames 1...

    Errors that points share (labels, foreground, smoothing) exceed what residuals show: factor,
    floor (scalar or [T-1 J]) and the largest deviation `most` are from training sequences.
    """
    sigma = np.minimum(np.hypot(factor * formal, floor), most)
    return np.concatenate([0 * sigma[:1], sigma])
