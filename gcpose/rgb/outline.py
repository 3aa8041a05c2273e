"""Points on the outline of what moves, and how what is seen there slides over the surface.

Where a round surface turns toward the camera, its outline does not move with the surface but slides
over it (Cipolla and Giblin, Visual Motion of Curves and Surfaces, 2000). Around a point of the
outline, the surface of a link is taken for a cylinder that is as thick as the link appears. The
edges of a door are rounded with a small radius: their outline and their shading move as the center
of the rounding does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, pinhole

_MIN_LENGTH = 1e-9
_NORMAL_BLUR = 1.5  # standard deviation of the blur before normals are taken, px
_MAX_RADIUS = 80  # px; nothing thicker is searched
_RISE = 0.5  # px that the distance from the outline may fall short while a radius is searched
_MAX_EDGE_SHARE = 0.1  # of its distance from the axis, by which an edge is nearer to it

OutlineKind = Literal["none", "round", "edge"]
"""Whether points on the outline are followed: of round links, or of the edges of a door."""


@dataclass(frozen=True)
class Outline:
    """Which of N pixels are on the outline, and the surface at those."""

    on: NDArray[np.bool_]
    """[N]"""
    normal: Array
    """[N 3] of the surface, outward and at right angles to the ray"""
    radius: Array
    """[N] half the thickness of the link, at depth 1; 0 on edges"""
    edge_radius: Array
    """[N] radius of the rounding of a door's edge that is seen around each pixel, in units of the
    distance; 0 elsewhere"""

    @property
    def is_round(self) -> bool:
        """Whether some of it slides over a round surface."""
        return bool(self.radius.any())

    @classmethod
    def none(cls, count: int) -> Outline:
        """Return the outline of pixels of which none is on it."""
        return cls(np.zeros(count, bool), np.zeros((count, 3)), np.zeros(count), np.zeros(count))


def sample_outline(moving: NDArray[np.bool_], cell: int) -> NDArray[np.int64]:
    """Return pixels [N 2] on the outline of a foreground [h w]: the one nearest to the mean of each
    cell, of a side in px."""
    inner = cv2.erode(moving.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
    v, u = np.nonzero(moving & ~inner)
    at = np.stack([u, v], axis=1)
    _, index, count = np.unique(
        v // cell * moving.shape[1] + u // cell, return_inverse=True, return_counts=True)
    total = np.stack([np.bincount(index, at[:, i], len(count)) for i in range(2)], axis=1)
    away = np.linalg.norm(at - (total / count[:, None])[index], axis=1)
    nearest = np.lexsort((away, index))[np.cumsum(count) - count]
    return at[nearest[count >= cell // 2]]  # few pixels only touch a cell


def surfaces_at_outline(
    moving: NDArray[np.bool_], intrinsics: Array, frame: NDArray[np.int64],
    pixel: NDArray[np.int64], on: NDArray[np.bool_],
) -> Outline:
    """Return the surfaces of links at those pixels [N 2] of frames [N] that are on the outline of
    the foreground [T h w]."""
    across, radius = np.zeros((len(on), 2)), np.zeros(len(on))
    for k in np.unique(frame[on]):
        mine = on & (frame == k)
        across[mine], radius[mine] = _normals_and_radii(moving[k].astype(np.uint8), pixel[mine])
    ray, focal = pinhole.pixel_rays(intrinsics, pixel), float(intrinsics[0, 0])
    tangent = np.stack([-across[:, 1], across[:, 0], np.zeros(len(on))], axis=1)
    return Outline(on, _unit_toward(np.cross(tangent, ray), across), radius / focal,
                   np.zeros(len(on)))


def edges_near_outline(
    moving: NDArray[np.bool_], frame: NDArray[np.int64], pixel: NDArray[np.int64],
    on: NDArray[np.bool_], radius: float, reach: float,
) -> Outline:
    """Return the edges of a door that pixels [N 2] of frames [N] show, of which some are on the
    outline of the foreground [T h w].

    The radius of their rounding falls from `radius` (in units of the distance) to 0 at `reach` px
    from the outline: farther inside, patches show what is on the face.
    """
    away, (u, v) = np.zeros(len(on)), pixel.T
    for k in np.unique(frame):
        mine = frame == k
        inside = cv2.distanceTransform(moving[k].astype(np.uint8), cv2.DIST_L2, 5)
        away[mine] = np.asarray(inside)[v[mine], u[mine]]
    return replace(Outline.none(len(on)), on=on,
                   edge_radius=radius * np.maximum(0.0, 1 - away / reach))


def _normals_and_radii(
    moving: NDArray[np.uint8], pixel: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Outward normals [N 2] of an outline, and the radii [N], px, of the circles inside of it."""
    height, width = moving.shape
    smooth = cv2.GaussianBlur(moving.astype(np.float32), (0, 0), _NORMAL_BLUR)
    slope_v, slope_u = (np.asarray(np.gradient(smooth, axis=a), np.float64) for a in (0, 1))
    u, v = pixel.T
    normal = -_unit(np.stack([slope_u[v, u], slope_v[v, u]], axis=1))
    inside = np.asarray(cv2.distanceTransform(moving, cv2.DIST_L2, 5))
    radius, rises = np.zeros(len(pixel)), np.ones(len(pixel), bool)
    for step in range(1, _MAX_RADIUS):  # inward until the other side of the link is nearer
        x, y = np.rint(pixel - step * normal).astype(np.int64).T
        distance = inside[y.clip(0, height - 1), x.clip(0, width - 1)]
        rises &= distance > radius - _RISE
        radius = np.where(rises, np.maximum(radius, distance), radius)
        if not rises.any():
            break
    return normal, radius


def slide_of_outline(
    outline: Outline, motion: Array, ray: Array, inverse_depth: Array, intrinsics: Array
) -> Array:
    """Return how far [N T 2], px, the outline slides over the surface, 0 for other pixels.

    The surface moves by motion [N T 4 4]; rays [N 3] and inverse depths [N] are of its points.
    """
    out = np.zeros((*motion.shape[:2], 2))
    on = np.flatnonzero(outline.on)
    rotation = motion[on, :, :3, :3]
    shift = inverse_depth[on, None, None] * motion[on, :, :3, 3]
    normal, radius = outline.normal[on], outline.radius[on, None]
    moved_normal = _rotate(rotation, normal)
    center = _rotate(rotation, ray[on] - radius * normal) + shift
    axis = _rotate(rotation, np.cross(normal, ray[on]))
    seen = _unit_toward(np.cross(center, axis), moved_normal)  # normal where the outline is now
    places = [at[..., :2] / np.maximum(0.05, at[..., 2:])
              for at in (center + radius[:, None] * n for n in (seen, moved_normal))]
    out[on] = intrinsics[[0, 1], [0, 1]] * (places[0] - places[1])
    return out


def slide_of_edges(
    outline: Outline, twist: Array, place: Array, frame: NDArray[np.int64], point: Array
) -> Array:
    """Return how far [N T 2], px, the rounded edges of a door slide over it.

    The door turns about a twist [6]; its points [N 3] at key frames [N] go to place [N T 2] px. The
    center of a rounding is nearer to the axis by its radius, and moves less by this share.
    """
    foot = np.cross(twist[:3], twist[3:])
    from_axis = np.linalg.norm(np.cross(point - foot, twist[:3]), axis=1)
    share = np.minimum(_MAX_EDGE_SHARE,
                       outline.edge_radius / np.maximum(_MIN_LENGTH, from_axis))
    start = place[np.arange(len(place)), frame]
    return np.asarray(share[:, None, None] * (start[:, None] - place))


def _rotate(rotation: Array, vector: Array) -> Array:
    """Vectors [N 3] under rotations [N T 3 3]."""
    return np.asarray(np.einsum("ntab,nb->nta", rotation, vector))


def _unit(vector: Array) -> Array:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector / np.maximum(_MIN_LENGTH, length))


def _unit_toward(vector: Array, other: Array) -> Array:
    """Unit vectors along [... 3], in the direction that agrees with others [... 2 or 3]."""
    agree = (vector[..., : other.shape[-1]] * other).sum(axis=-1, keepdims=True)
    return np.where(agree < 0, -1.0, 1.0) * _unit(vector)
