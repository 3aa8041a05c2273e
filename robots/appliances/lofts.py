"""Surfaces through a row of outlines, with exact normals: the same numbers on every machine.

Sines are rounded before they are used, and what follows is addition, multiplication and square
roots, which IEEE 754 defines to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import Array

_ARC = 5
"""Facets of a rounded corner of an outline."""


@dataclass(frozen=True)
class Solid:
    """Triangles; not necessarily closed."""

    vertices: Array
    """[V 3] m"""
    normals: Array
    """[V 3] unit"""
    faces: NDArray[np.int64]
    """[F 3]"""
    uv: Array | None = None
    """[V 2]; None: projected from the faces' own planes, a tile a metre"""


@dataclass(frozen=True)
class Ring:
    """One outline of a loft."""

    points: Array
    """[N 3]"""
    normals: Array
    """[N 3] of the surface there"""


def cosine(degrees: ArrayLike) -> Array:
    """Of angles in degrees, equal on every machine."""
    radians: Array = np.asarray(degrees, np.float64) * (np.pi / 180.0)
    return np.asarray(np.cos(radians).round(9), np.float64)


def sine(degrees: ArrayLike) -> Array:
    """Of angles in degrees, equal on every machine."""
    return cosine(90.0 - np.asarray(degrees, np.float64))


def rounded_rectangle(width: float, height: float, radius: float) -> tuple[Array, Array]:
    """Outline [N 2] about the origin, counter-clockwise, and its normals [N 2]."""
    r = max(min(radius, width / 2.0, height / 2.0), 0.0)
    angles = (90.0 * np.arange(4)[:, None] + np.linspace(0.0, 90.0, _ARC + 1)).ravel()
    normal = np.stack([cosine(angles), sine(angles)], axis=1)
    corner = np.repeat([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]], _ARC + 1, axis=0)
    return corner * [width / 2.0 - r, height / 2.0 - r] + r * normal, normal


def circle(radius: float, sides: int = 24) -> tuple[Array, Array]:
    """Outline [N 2] about the origin, counter-clockwise, and its normals [N 2]."""
    angles = 360.0 * np.arange(sides) / sides
    normal = np.stack([cosine(angles), sine(angles)], axis=1)
    return radius * normal, normal


def loft(rings: Sequence[Ring], first_cap: bool = False, last_cap: bool = False,
         closed: bool = False) -> Solid:
    """The skin through rings of equally many points, each counter-clockwise seen from where the
    rings go; caps close the ends (outlines convex), `closed` joins the last ring to the first."""
    n = len(rings[0].points)
    vertices = [ring.points for ring in rings]
    normals = [ring.normals for ring in rings]
    i = np.arange(n)
    j = (i + 1) % n
    faces: list[NDArray[np.int64]] = []
    for k in range(len(rings) if closed else len(rings) - 1):
        a, b = k * n, (k + 1) % len(rings) * n
        if np.array_equal(rings[k].points, rings[(k + 1) % len(rings)].points):
            continue  # the same outline with another normal: a sharp edge
        faces += [np.stack([a + i, a + j, b + j], 1), np.stack([a + i, b + j, b + i], 1)]
    fan = np.stack([np.zeros(n - 2, np.int64), i[1:-1], i[2:]], 1)
    for wanted, ring, turned in ((first_cap, rings[0], True), (last_cap, rings[-1], False)):
        if not wanted:
            continue
        p = ring.points
        normal = np.cross(p[n // 3] - p[0], p[2 * n // 3] - p[0]) * (-1.0 if turned else 1.0)
        faces.append((fan[:, ::-1] if turned else fan) + n * len(vertices))
        vertices.append(p)
        normals.append(np.broadcast_to(normal / np.sqrt((normal * normal).sum()), p.shape))
    return Solid(np.concatenate(vertices), np.concatenate(normals), np.concatenate(faces))


def ring(outline: tuple[Array, Array], z: float, out: float = 1.0, up: float = 0.0) -> Ring:
    """An outline in the plane z, where the surface faces `out` along the outline's normals and
    `up` along z (their squares sum to 1)."""
    points, normal = outline
    return Ring(np.column_stack([points, np.full(len(points), z)]),
                np.column_stack([out * normal, np.full(len(points), up)]))
