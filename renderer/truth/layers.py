"""Optional truth of every pixel: surface normals, and coordinates on the object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, apply, inverse
from ...robots.model import ArticulatedModel
from .correspondence import SurfacePoints
from .deforming import DeformingPoints


def normal_image(
    face: NDArray[np.int32], corners: NDArray[np.int64], vertices: Array
) -> NDArray[np.float32]:
    """Unit normals [H W 3] in the camera frame of the triangles `face` [H W] (-1: none; NaN there).

    Of the triangle itself, not of a smooth shading, and on the side that one sees. `corners` [F 3]
    are rows of `vertices` [V 3] m in the camera frame.
    """
    seen = np.flatnonzero(face >= 0)
    number, of_seen = np.unique(face.ravel()[seen], return_inverse=True)
    a, b, c = (vertices[corners[number, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # The plane through a is seen from the side that the camera, the origin, is on.
    side = -np.sign((normals * a).sum(axis=1, keepdims=True))
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.where((length > 0) & (side != 0), normals * side / length, np.nan)
    out = np.full((*face.shape, 3), np.nan, np.float32)
    out.reshape(-1, 3)[seen] = unit[of_seen.ravel()]
    return out


def coordinate_image(
    points: SurfacePoints, cam_from_part: Array, deforming: DeformingPoints | None,
    at_rest: Array, shape: tuple[int, int],
) -> NDArray[np.float32]:
    """Where each pixel's point is in its part's own frame, [H W 3] m; NaN where there is no part.

    From the points of a frame and the poses cam_from_part [P+1 4 4] by part number. A point that
    deforms has the place that it has at rest: `at_rest` [V 3] (posed_model.rest_in_part).
    """
    found = np.full((len(points.index), 3), np.nan)
    for number in range(1, len(points.first) - 1):
        part = points.of_part(number)
        found[part] = apply(inverse(cam_from_part[number]), points.points[part])
    if deforming is not None:
        found[deforming.chosen] = np.einsum(
            "mk,mki->mi", deforming.weight, at_rest[deforming.corner])
    out = np.full((*shape, 3), np.nan, np.float32)
    out.reshape(-1, 3)[points.index] = found
    return out


def coordinate_boxes(model: ArticulatedModel, at_rest: Array) -> Array:
    """[P 2 3] m: least and greatest coordinates of each part's surfaces at rest, in its frame;
    zeros for a part without any. `at_rest` [V 3] is from `posed_model.rest_in_part`.
    """
    part = np.repeat([v.part for v in model.visuals], [len(v.vertices) for v in model.visuals])
    boxes = np.zeros((len(model.parent), 2, 3))
    for p in np.unique(part):
        mine = at_rest[part == p]
        boxes[p] = mine.min(0), mine.max(0)
    return boxes
