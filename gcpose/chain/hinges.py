"""Where parts hang together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from .kernels import fill_hinges
from .kinematics import carriers
from .settings import ChainSettings


def hinges(
    points: Array, label: NDArray[np.int64], base: Array, parent: NDArray[np.int64],
    settings: ChainSettings,
) -> Array:
    """[J 3] about where part j meets what carries it; what nothing carries meets the base [3]."""
    out = np.empty((len(parent), 3))
    fill_hinges(points, label, base, parent, carriers(parent), settings.hinge_points,
                settings.hinge_divisor, out)
    return out


def thinned(points: Array, most: int) -> Array:
    """At most `most` of the points [N 3]."""
    return points[np.linspace(0, len(points) - 1, min(len(points), most)).astype(int)]


def extent(points: Array, settings: ChainSettings) -> float:
    """Size of the points [N 3] along the camera axis they stretch most along, but for strays, m."""
    low, high = np.quantile(points, [settings.extent_margin, 1 - settings.extent_margin], axis=0)
    return float((high - low).max())
