"""Optical flow of surfaces that deform: each corner of a triangle moves by itself.

The triangle that a pixel shows is known, and where its three corners are at either instant. The
pixel's ray gives the weights of the corners; what they move by, so weighted, moves the point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..scene import PosedModel
from .correspondence import PointMotion, SurfacePoints, project_in_front


@dataclass(frozen=True)
class DeformingPoints:
    """Those of the N points of a frame that are on triangles which deform: M of them."""

    points: SurfacePoints
    chosen: NDArray[np.intp]
    """[M] index into the points"""
    corner: NDArray[np.int64]
    """[M 3] rows of `PosedModel.vertices`"""
    weight: Array
    """[M 3] of the corners, sum to 1"""
    here: Array
    """[M 3 3] m, the corners in the camera frame of this instant"""

    def motion(self, rigid: PointMotion, vertices: Array) -> PointMotion:
        """All points in another frame, whose vertices [V 3] m (camera frame) are given; `rigid` is
        where they would be if each moved with its part.
        """
        shift = np.einsum("mk,mki->mi", self.weight, vertices[self.corner] - self.here)
        points = self.points.points[self.chosen] + shift
        uv, z = project_in_front(self.points.intrinsics, points)
        flow, depth = rigid.flow.copy(), rigid.depth.copy()
        stands = (shift == 0).all(axis=1, keepdims=True)
        flow[self.chosen] = np.where(stands, 0.0, uv - self.points.pixels[self.chosen])
        depth[self.chosen] = z
        return PointMotion(flow, depth)


def deforming_points(
    points: SurfacePoints, face: NDArray[np.int32], posed: PosedModel, vertices: Array
) -> DeformingPoints:
    """The points that are on triangles `face` [H W] of the model that deform; its vertices [V 3] m
    are in the camera frame.
    """
    number = face.ravel()[points.index]
    chosen = np.flatnonzero((number >= 0) & posed.face_deforms[number])
    corner = posed.faces[number[chosen]]
    here = vertices[corner]
    return DeformingPoints(points, chosen, corner, weights(points.points[chosen], here), here)


def weights(rays: Array, corners: Array) -> Array:
    """[N 3] weights of the corners [N 3 3] of triangles at the points where rays [N 3] meet them.

    All in one frame whose origin the rays come from. A rasterizer moves corners by a fraction of a
    pixel: a point beside the triangle becomes one on its edge, and one on a triangle that is seen
    edge-on gets equal weights.
    """
    a, b, c = (corners[:, i] for i in range(3))
    volume = np.stack([np.einsum("ni,ni->n", rays, np.cross(p, q))
                       for p, q in ((b, c), (c, a), (a, b))], axis=1)
    total = volume.sum(axis=1, keepdims=True)
    share = np.maximum(volume * np.sign(total), 0.0)
    total = share.sum(axis=1, keepdims=True)
    return np.where(total > 0, share / np.where(total > 0, total, 1.0), 1.0 / 3.0)

