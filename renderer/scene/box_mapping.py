"""Texture coordinates for meshes that have none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array

Faces = NDArray[np.int32]

_SIDES = np.array([[1, 2], [0, 2], [0, 1]])
"""The two coordinates that remain in a projection along x, y, z."""
_OFFSETS = np.array([[0.0, 0.0], [0.37, 0.61], [0.71, 0.23]])
"""Shift of each axis in tiles: adjacent sides of a box do not mirror each other."""


def split_by_axis(
    vertices: Array, faces: Faces, scale: float
) -> tuple[NDArray[np.intp], Faces, Array]:
    """Return the old number [V'] of each new vertex, faces [F 3] and uv [V' 2].

    A tile is `scale` m wide. Each face is projected along the axis nearest to its normal. Vertices
    [V 3] that faces of different axes share are split, unused ones removed; faces keep their order.
    """
    if not scale > 0:
        raise ValueError(f"the size of a tile must be positive, not {scale}")
    first, second, third = (vertices[faces[:, i]] for i in range(3))
    axis = np.abs(np.cross(second - first, third - first)).argmax(1)
    # A new vertex is a pair (axis, old vertex); a table over all pairs is faster than np.unique.
    pair = axis[:, None] * len(vertices) + faces
    used = np.zeros(3 * len(vertices), bool)
    used[pair] = True
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    new_axis, old = np.divmod(np.flatnonzero(used), max(len(vertices), 1))
    uv = np.take_along_axis(vertices[old], _SIDES[new_axis], 1) / scale + _OFFSETS[new_axis]
    return old, number[pair], uv
