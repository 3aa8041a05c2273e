"""Robust costs, and weights of iteratively reweighted least squares.

All take squared residuals [...] in squared robust scales, s = (r / scale)^2. A weight is the
derivative of its cost by s, so that a weighted least-squares step descends the cost (Huber, Robust
Statistics, 1981, section 7.8). Compiled kernels repeat the formulas that they need.
"""

from __future__ import annotations

import numpy as np

from ...robots.geometry import Array


def geman_mcclure_cost(square: Array) -> Array:
    """Return s / (1 + s); its weight is 1 / (1 + s)^2.

    Source: Geman and McClure, Statistical methods for tomographic image reconstruction, Bulletin of
    the International Statistical Institute 52 (1987).
    """
    return square / (1.0 + square)


def cauchy_weight(square: Array) -> Array:
    """Return 1 / (1 + s), of the cost log(1 + s): the logarithm of Cauchy's density."""
    return 1.0 / (1.0 + square)


def truncated_cost(square: Array, limit: float) -> Array:
    """Return min(s, limit): outliers cost the same, wherever they are (Blake and Zisserman, Visual
    Reconstruction, 1987)."""
    return np.minimum(square, limit)
