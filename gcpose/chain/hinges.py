"""Hinges: places where a part meets its parent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from .kernels import fill_hinges
from .kinematics import ancestors
from .settings import ChainSettings


def locate_hinges(
    points: Array, label: NDArray[np.int64], base: Array, parent: NDArray[np.int64],
    settings: ChainSettings,
) -> Array:
    """Return the place [J 3] where the part of each joint meets its parent part; `base` [3] for
    joints on the base. Points [N 3] have labels [N] 0..J."""
    out = np.empty((len(parent), 3))
    fill_hinges(points, label, base, parent, ancestors(parent), settings.hinge_points,
                settings.hinge_divisor, out)
    return out


def subsample(points: Array, most: int) -> Array:
    """Return at most `most` of the points [N 3], evenly by index."""
    return points[np.linspace(0, len(points) - 1, min(len(points), most)).astype(int)]


def extent(points: Array, settings: ChainSettings) -> float:
    """Return the largest extent of the points [N 3] along a camera axis without outliers, m."""
    low, high = np.quantile(points, [settings.extent_margin, 1 - settings.extent_margin], axis=0)
    return float((high - low).max())
