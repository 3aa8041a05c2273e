"""Solids for appliances: lofts through outlines, with exact normals.

Seen from the front of an appliance, x points right, y up and z towards the viewer. Lengths are in
m. The numbers are the same on every machine: sines are rounded before use, and all further
arithmetic is addition, multiplication, division and square roots, which IEEE 754 defines to the
last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import Array

Vector = tuple[float, float, float]
"""x, y, z: a point in m, or a direction."""
_ARC = 5
"""Facets of a rounded corner of an outline."""


@dataclass(frozen=True)
class Solid:
    """A triangle mesh, closed or open."""

    vertices: Array
    """[V 3] m"""
    normals: Array
    """[V 3] unit"""
    faces: NDArray[np.int64]
    """[F 3]"""
    uv: Array | None = None
    """[V 2] texture coordinates; None: each face is projected along an axis."""


@dataclass(frozen=True)
class Ring:
    """One outline of a loft."""

    points: Array
    """[N 3]"""
    normals: Array
    """[N 3] of the surface there"""


def cosine(degrees: ArrayLike) -> Array:
    """Return cosines of angles in degrees, equal on every machine."""
    radians: Array = np.asarray(degrees, np.float64) * (np.pi / 180.0)
    return np.asarray(np.cos(radians).round(9), np.float64)


def sine(degrees: ArrayLike) -> Array:
    """Return sines of angles in degrees, equal on every machine."""
    return cosine(90.0 - np.asarray(degrees, np.float64))


def rounded_rectangle(width: float, height: float, radius: float) -> tuple[Array, Array]:
    """Return an outline [N 2] about the origin, counter-clockwise, and its normals [N 2]."""
    r = max(min(radius, width / 2.0, height / 2.0), 0.0)
    angles = (90.0 * np.arange(4)[:, None] + np.linspace(0.0, 90.0, _ARC + 1)).ravel()
    normal = np.stack([cosine(angles), sine(angles)], axis=1)
    corner = np.repeat([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]], _ARC + 1, axis=0)
    return corner * [width / 2.0 - r, height / 2.0 - r] + r * normal, normal


def circle_outline(radius: float, sides: int = 24) -> tuple[Array, Array]:
    """Return an outline [N 2] about the origin, counter-clockwise, and its normals [N 2]."""
    angles = 360.0 * np.arange(sides) / sides
    normal = np.stack([cosine(angles), sine(angles)], axis=1)
    return radius * normal, normal


def loft(rings: Sequence[Ring], first_cap: bool = False, last_cap: bool = False,
         closed: bool = False) -> Solid:
    """Return the surface through rings of N points each.

    Each ring is counter-clockwise as seen from the rings after it. Caps close the ends, whose
    outlines must be convex; `closed` joins the last ring to the first.
    """
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


_EDGE = 3
"""Facets of a rounded edge."""
_STEPS = np.linspace(0.0, 90.0, _EDGE + 1)


def _front_edge(
    outline: Callable[[float], tuple[Array, Array]], z: float, edge: float
) -> list[Ring]:
    """Rings from the side of a solid to its front at z; `outline` is inset by the radius `edge`."""
    return [ring(outline(edge * (1 - c)), z - edge * (1 - s), c, s)
            for c, s in zip(cosine(_STEPS), sine(_STEPS), strict=True)] if edge > 0 else \
        [ring(outline(0.0), z)]


def _back_edge(
    outline: Callable[[float], tuple[Array, Array]], z: float, edge: float
) -> list[Ring]:
    """The same from the back at z to the side."""
    return [ring(outline(edge * (1 - c)), z + edge * (1 - s), c, -s)
            for c, s in zip(sine(_STEPS), cosine(_STEPS), strict=True)] if edge > 0 else \
        [ring(outline(0.0), z)]


def _inset_rectangle(
    width: float, height: float, radius: float
) -> Callable[[float], tuple[Array, Array]]:
    return lambda inset: rounded_rectangle(
        width - 2 * inset, height - 2 * inset, max(radius - inset, 0.0))


def slab(width: float, height: float, z: tuple[float, float], radius: float = 0.0,
         edge: float = 0.0, back_edge: float = 0.0) -> Solid:
    """Return a plate in the x-y plane from z[0] to z[1].

    `radius` rounds its corners, `edge` and `back_edge` the edges around its front and its back.
    """
    outline = _inset_rectangle(width, height, radius)
    rings = _back_edge(outline, z[0], back_edge) + _front_edge(outline, z[1], edge)
    return loft(rings, first_cap=True, last_cap=True)


@dataclass(frozen=True)
class Hole:
    """A rounded rectangular hole in a plate or in the front of a box; lengths in m."""

    x: float
    """Of the center."""
    y: float
    width: float
    height: float
    radius: float = 0.0
    """Of the corners."""

    def outline(self) -> tuple[Array, Array]:
        """Points [N 2] of the rim, counter-clockwise, and their normals [N 2] into the hole."""
        points, normal = rounded_rectangle(self.width, self.height, self.radius)
        return points + np.array([self.x, self.y]), -normal


def frame(width: float, height: float, hole: Hole, z: tuple[float, float], radius: float = 0.0,
          edge: float = 0.0) -> Solid:
    """Return a plate like `slab` with a hole."""
    outer, inner = _inset_rectangle(width, height, radius), hole.outline()
    return loft([ring(outer(0.0), z[0], 0.0, -1.0), ring(outer(0.0), z[0]),
                 *_front_edge(outer, z[1], edge), ring(outer(edge), z[1], 0.0, 1.0),
                 ring(inner, z[1], 0.0, 1.0), ring(inner, z[1]), ring(inner, z[0]),
                 ring(inner, z[0], 0.0, -1.0)], closed=True)


def shell(width: float, height: float, z: tuple[float, float], hole: Hole, radius: float,
          edge: float) -> Solid:
    """Return the outside of a box and its front around a hole, where a `cavity` belongs."""
    back = _back_edge(_inset_rectangle(width, height, radius), z[0], edge)
    front = [Ring(b.points * [1.0, 1.0, 0.0] + [0.0, 0.0, z[1] + z[0] - b.points[0, 2]],
                  b.normals * [1.0, 1.0, -1.0]) for b in reversed(back)]
    return loft([*back, *front, ring(hole.outline(), z[1], 0.0, 1.0)], first_cap=True)


def cavity(opening: tuple[float, float], z: tuple[float, float], radius: float) -> Solid:
    """Return the inside of a box about the origin: walls and back at z[0], facing inward."""
    points, normal = rounded_rectangle(*opening, radius)
    outline = points, -normal
    walls = loft([ring(outline, z[1]), ring(outline, z[0])])
    return join([walls, loft([ring(outline, z[0])], last_cap=True)])


def disc(radius: float, z: tuple[float, float], edge: float = 0.0, sides: int = 24,
         top: float | None = None) -> Solid:
    """Return a cylinder along z, tapered to the radius `top`, its front edge rounded by `edge`."""
    last = radius if top is None else top
    front = _front_edge(lambda inset: circle_outline(last - inset, sides), z[1], edge)
    return loft([ring(circle_outline(radius, sides), z[0]), *front], first_cap=True, last_cap=True)


def tube(path: ArrayLike, radius: float, normal: ArrayLike, sides: int = 10,
         flat: float = 1.0) -> Solid:
    """Return a bar along the points `path` [K 3] of a plane with the unit normal `normal` [3].

    Its radius is `radius` in the plane and `flat` times that across the plane.
    """
    p, across = np.asarray(path, np.float64), np.asarray(normal, np.float64)
    step = np.diff(p, axis=0)
    step = step / np.sqrt((step * step).sum(1, keepdims=True))
    before, after = np.vstack([step[:1], step]), np.vstack([step, step[-1:]])
    along = before + after
    length = np.sqrt((along * along).sum(1, keepdims=True))  # 2 cos(half the bend)
    along = along / length
    side = np.cross(across, along)
    unit = circle_outline(1.0, sides)[1]
    rings: list[Ring] = []
    for k in range(len(p)):
        wide = 2.0 / float(length[k, 0])  # a mitre is wider than the bar
        offset = unit[:, :1] * side[k] * wide + unit[:, 1:] * across * flat
        facing = unit[:, :1] * side[k] + unit[:, 1:] * across / flat
        facing = facing / np.sqrt((facing * facing).sum(1, keepdims=True))
        rings.append(Ring(p[k] + radius * offset, facing))
    return loft(rings, first_cap=True, last_cap=True)


def wire(a: ArrayLike, b: ArrayLike, radius: float, sides: int = 6) -> Solid:
    """Return a straight bar from a to b, each [3]."""
    line = np.asarray([a, b], np.float64)
    along = np.abs(line[1] - line[0])
    other = np.eye(3)[int(np.argmin(along))]
    normal = np.cross(line[1] - line[0], other)
    return tube(line, radius, normal / np.sqrt((normal * normal).sum()), sides)


def image_quad(width: float, height: float, z: float) -> Solid:
    """Return a rectangle that faces +z and shows a whole texture once."""
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float64)
    vertices = np.column_stack([corner * [width / 2.0, height / 2.0], np.full(4, z)])
    return Solid(vertices, np.tile([0.0, 0.0, 1.0], (4, 1)), np.array([[0, 1, 2], [0, 2, 3]]),
                 (corner + 1.0) / 2.0)


_TURNS = {
    "right": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float64),
    "left": np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], np.float64),
    "up": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float64),
    "down": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float64),
    "back": np.array([[-1, 0, 0], [0, 1, 0], [0, 0, -1]], np.float64),
}


def orient(solid: Solid, where: str) -> Solid:
    """Return the solid turned so that its +z points right, left, up, down or back."""
    turn = _TURNS[where]
    # one term of each sum is not zero, so that the order of summation does not matter
    return Solid(solid.vertices @ turn.T, solid.normals @ turn.T, solid.faces, solid.uv)


def shift(solid: Solid, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Solid:
    """Return the solid moved by x, y, z."""
    return Solid(solid.vertices + np.array([x, y, z]), solid.normals, solid.faces, solid.uv)


def join(solids: Sequence[Solid]) -> Solid:
    """Return the solids as one; texture coordinates are kept if all have them."""
    starts = np.cumsum([0, *(len(s.vertices) for s in solids)])
    uvs = [s.uv for s in solids if s.uv is not None]
    return Solid(
        np.concatenate([s.vertices for s in solids]), np.concatenate([s.normals for s in solids]),
        np.concatenate([s.faces + start for s, start in zip(solids, starts, strict=False)]),
        np.concatenate(uvs) if len(uvs) == len(solids) else None)
