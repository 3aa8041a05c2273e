"""Robust costs and their weights in iteratively reweighted least squares.

All take squared residuals [...] in squared robust scales, s = (r / scale)^2. The weight is the
derivative of the cost by s, so that a weighted least-squares step descends the cost (Huber, Robust
Statistics, 1981, section 7.8). Compiled kernels repeat the formulas that they need.
"""

from __future__ import annotations

import numpy as np

from ...robots.geometry import Array


def geman_mcclure_cost(square: Array) -> Array:
    """Return s / (1 + s).

    Source: Geman and McClure, Statistical methods for tomographic image reconstruction, Bulletin of
    the International Statistical Institute 52 (1987).
    """
    return square / (1.0 + square)


def geman_mcclure_weight(square: Array) -> Array:
    """Return 1 / (1 + s)^2."""
    return 1.0 / (1.0 + square) ** 2


def cauchy_cost(square: Array) -> Array:
    """Return log(1 + s): the logarithm of Cauchy's density, which forgives less than the others."""
    return np.log1p(square)


def cauchy_weight(square: Array) -> Array:
    """Return 1 / (1 + s)."""
    return 1.0 / (1.0 + square)


def truncated_cost(square: Array, limit: float = 1.0) -> Array:
    """Return min(s, limit): outliers cost the same, wherever they are (Blake and Zisserman, Visual
    Reconstruction, 1987)."""
    return np.minimum(square, limit)


def truncated_weight(square: Array, limit: float = 1.0) -> Array:
    """Return 1 where s < limit, else 0."""
    return (square < limit).astype(np.float64)
