"""Convex hulls."""

from __future__ import annotations

from .transforms import Array


def hull_vertices(points: Array) -> Array:
    """Return the points [H 3] of points [N 3] that are vertices of their convex hull.

    Points that span no volume are returned as they are.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return points
