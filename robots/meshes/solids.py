"""Closed solids; their triangles are counter-clockwise seen from outside.

The primitives of URDF are centered, have their axis along z, and have analytic normals and texture
coordinates. Hulls, rounded blocks, rods, and plates with holes serve generated models.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ModelError
from ..geometry import Array, transform
from ..model import TriangleSurface, clean_surface, move_surface

SIDES = 32
"""Facets per full turn of the solids of generated models."""
_AROUND = 64
"""Facets per full turn of the primitives of URDF; error 0.12 % of the radius."""


def box(size: Sequence[float]) -> TriangleSurface:
    """Return a box of edge lengths `size` [3] m."""
    _positive("box", size)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float64)
    vertices, normals = np.zeros((6, 4, 3)), np.zeros((6, 4, 3))
    for face in range(6):
        axis, sign = face // 2, 1.0 if face % 2 else -1.0
        u, v = (axis + 1) % 3, (axis + 2) % 3
        vertices[face, :, axis], normals[face, :, axis] = sign, sign
        vertices[face, :, u], vertices[face, :, v] = corners[:, 0] * sign, corners[:, 1]
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    return TriangleSurface(vertices.reshape(-1, 3) * np.asarray(size, np.float64) / 2.0,
                   np.concatenate([quad + 4 * face for face in range(6)]),
                   normals.reshape(-1, 3), np.tile((corners + 1.0) / 2.0, (6, 1)))


def sphere(radius: float) -> TriangleSurface:
    """Return a sphere of `radius` m."""
    _positive("sphere", [radius])
    polar = np.linspace(np.pi, 0.0, _AROUND // 2 + 1)
    return revolve(radius * np.sin(polar), radius * np.cos(polar), np.sin(polar), np.cos(polar))


def cylinder(radius: float, length: float) -> TriangleSurface:
    """Return a closed cylinder of `radius` and `length` m."""
    _positive("cylinder", [radius, length])
    h = length / 2.0
    parts = [
        revolve([0.0, radius], [-h, -h], [0.0, 0.0], [-1.0, -1.0]),
        revolve([radius, radius], [-h, h], [1.0, 1.0], [0.0, 0.0]),
        revolve([radius, 0.0], [h, h], [0.0, 0.0], [1.0, 1.0]),
    ]
    return join_surfaces(parts)


def capsule(radius: float, length: float) -> TriangleSurface:
    """Return a cylinder of `radius` and `length` m with a hemisphere at each end."""
    _positive("capsule", [radius])
    if length < 0:
        raise ModelError(f"capsule of length {length}: sizes must not be negative")
    polar = np.linspace(np.pi, 0.0, _AROUND // 2 + 1)
    lower, upper = polar[: _AROUND // 4 + 1], polar[_AROUND // 4:]
    both = np.concatenate([lower, upper] if length else [polar])
    shift = np.where(np.arange(len(both)) < len(lower), -length / 2.0, length / 2.0)
    return revolve(radius * np.sin(both), radius * np.cos(both) + shift, np.sin(both), np.cos(both))


def revolve(
    r: ArrayLike, z: ArrayLike, normal_r: ArrayLike, normal_z: ArrayLike
) -> TriangleSurface:
    """Revolve the profile (r, z), ordered so that the outside goes upward, about the z axis."""
    r, z, nr, nz = (np.asarray(x, np.float64) for x in (r, z, normal_r, normal_z))
    r = np.where(np.abs(r) < 1e-12 * max(float(np.abs(r).max()), 1e-300), 0.0, r)
    rings, columns = len(r), _AROUND + 1  # vertices at the seam: u = 0 and u = 1
    turn = np.linspace(0.0, 2.0 * np.pi, columns)
    c, s = np.cos(turn), np.sin(turn)
    c[-1], s[-1] = c[0], s[0]
    ones = np.ones(columns)
    vertices = np.stack([np.outer(r, c), np.outer(r, s), np.outer(z, ones)], axis=-1)
    normals = np.stack([np.outer(nr, c), np.outer(nr, s), np.outer(nz, ones)], axis=-1)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(r), np.diff(z)))])
    uv = np.stack(np.meshgrid(np.linspace(0.0, 1.0, columns), along / along[-1]), axis=-1)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(rings - 1), np.arange(_AROUND), indexing="ij"))
    a, b, c0, d = i * columns + j, i * columns + j + 1, (i + 1) * columns + j + 1, (
        i + 1) * columns + j
    below, above = r[i] > 0, r[i + 1] > 0  # no degenerate triangles at poles
    faces = np.concatenate([np.stack([a, b, c0], -1)[below], np.stack([a, c0, d], -1)[above]])
    return TriangleSurface(
        vertices.reshape(-1, 3), faces, normals.reshape(-1, 3), uv.reshape(-1, 2))


def join_surfaces(parts: Sequence[TriangleSurface]) -> TriangleSurface:
    counts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    uvs: list[Array] = [p.uv for p in parts if p.uv is not None]
    return TriangleSurface(np.concatenate([p.vertices for p in parts]),
                   np.concatenate([p.faces + n for p, n in zip(parts, counts, strict=False)]),
                   np.concatenate([p.normals for p in parts]), np.concatenate(uvs))


def _positive(kind: str, sizes: Sequence[float]) -> None:
    if not all(np.isfinite(s) and s > 0 for s in sizes):
        shown = " ".join(f"{s:g}" for s in sizes)
        raise ModelError(f"{kind} of size {shown}: sizes must be positive numbers of metres")


def hull(points: ArrayLike) -> TriangleSurface:
    """Return the convex hull of points [N 3]."""
    from scipy.spatial import ConvexHull

    p = np.asarray(points, np.float64)
    found = ConvexHull(p)
    f = found.simplices.astype(np.int64)
    normal = np.cross(p[f[:, 1]] - p[f[:, 0]], p[f[:, 2]] - p[f[:, 0]])
    inward = np.einsum("fi,fi->f", normal, found.equations[:, :3]) < 0
    f[inward] = f[inward][:, ::-1]
    return _solid(p, f)


def block(low: ArrayLike, high: ArrayLike, radius: float = 0.0) -> TriangleSurface:
    """Return a box between two corners [3], its edges rounded by `radius`."""
    a, b = np.asarray(low, np.float64) + radius, np.asarray(high, np.float64) - radius
    corners = np.stack(np.meshgrid(*np.stack([a, b], axis=1), indexing="ij"), -1).reshape(-1, 3)
    if radius == 0.0:
        return hull(corners)
    polar, turn = np.meshgrid(np.linspace(0, np.pi, 9), np.linspace(0, 2 * np.pi, 17)[:-1])
    ball = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], -1)
    points = corners[:, None] + radius * ball.reshape(-1, 3)
    return hull(np.unique(np.round(points.reshape(-1, 3), 9), axis=0))


def rod(start: ArrayLike, end: ArrayLike, radius: float, end_radius: float | None = None,
        sides: int = SIDES) -> TriangleSurface:
    """Return a cylinder between two points [3], or a cone if `end_radius` differs."""
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    along = (b - a) / np.linalg.norm(b - a)
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    turn = np.linspace(0.0, 2.0 * np.pi, sides + 1)[:-1, None]
    circle = np.cos(turn) * across + np.sin(turn) * np.cross(along, across)
    return hull(np.concatenate([
        a + radius * circle, b + (radius if end_radius is None else end_radius) * circle]))


def plate(outline: ArrayLike, span: tuple[float, float], holes: Sequence[ArrayLike] = (),
          axis: str = "z") -> TriangleSurface:
    """Extrude an outline [N 2] with holes [M 2] over the interval `span` of an axis.

    The outline is in (x, y) for the axis "z", in (x, z) for "y", in (y, z) for "x". All loops run
    counter-clockwise and must not touch (else ModelError).
    """
    import mapbox_earcut

    loops = [np.asarray(loop, np.float64) for loop in (outline, *holes)]
    points, ends = np.concatenate(loops), np.cumsum([len(loop) for loop in loops])
    n = len(points)
    flat = mapbox_earcut.triangulate_float64(points, ends.astype(np.uint32))
    top = flat.astype(np.int64).reshape(-1, 3)
    a, b, c = (points[top[:, i]] for i in range(3))
    turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
    top[turned] = top[turned][:, ::-1]
    walls: list[NDArray[np.int64]] = []
    for k, (end, loop) in enumerate(zip(ends, loops, strict=True)):
        i = np.arange(end - len(loop), end)
        j = np.roll(i, -1)
        i, j = (i, j) if k == 0 else (j, i)  # walls of holes face inward
        walls += [np.stack([i, j, j + n], -1), np.stack([i, j + n, i + n], -1)]
    faces = np.concatenate([top[:, ::-1], top + n, *walls])
    if not _is_closed(faces):
        raise ModelError("the loops of a plate touch, or run the wrong way")
    vertices = np.concatenate([np.insert(points, 2, z, axis=1) for z in sorted(span)])
    # cyclic permutations for x and z, a mirror for y: `move_surface` reverses its triangles
    order = {"x": [2, 0, 1], "y": [0, 2, 1], "z": [0, 1, 2]}[axis]
    solid = _solid(vertices, faces)
    return move_surface(solid, transform(np.eye(3)[:, order].T)) if axis != "z" else solid


def round_corners(corners: ArrayLike, radius: ArrayLike) -> Array:
    """Return a counter-clockwise polygon [N 2] with its corners [C 2] rounded.

    `radius` is a scalar or [C]; corners may be convex or concave.
    """
    p = np.asarray(corners, np.float64)
    r = np.broadcast_to(np.asarray(radius, np.float64), len(p))
    before, after = p - np.roll(p, 1, axis=0), np.roll(p, -1, axis=0) - p
    u = before / np.linalg.norm(before, axis=1, keepdims=True)
    v = after / np.linalg.norm(after, axis=1, keepdims=True)
    turn = np.arctan2(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0], np.einsum("ni,ni->n", u, v))
    points: list[Array] = []
    for i in range(len(p)):
        left = np.sign(turn[i]) * np.array([-u[i, 1], u[i, 0]])
        first = p[i] - u[i] * r[i] * np.tan(abs(turn[i]) / 2)
        count = max(2, int(np.ceil(abs(turn[i]) / (2 * np.pi / SIDES))) + 1)
        angle = np.linspace(0.0, abs(turn[i]), count)[:, None]
        points.append(first + r[i] * (np.sin(angle) * u[i] + (1 - np.cos(angle)) * left))
    loop = np.concatenate(points)
    return loop[np.linalg.norm(loop - np.roll(loop, 1, axis=0), axis=1) > 1e-6]


def circle(center: ArrayLike, radius: float, sides: int = SIDES) -> Array:
    """Return a counter-clockwise circle [sides 2]."""
    turn = np.linspace(0.0, 2.0 * np.pi, sides + 1)[:-1]
    return np.asarray(center, np.float64) + radius * np.stack([np.cos(turn), np.sin(turn)], -1)


def bar(start: ArrayLike, end: ArrayLike, radius: float, end_radius: float | None = None,
        waist: float = 1.0) -> Array:
    """Return the outline [N 2] of a bar with round ends about two points [2]; `waist` scales the
    width in the middle."""
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    length = float(np.linalg.norm(b - a))
    u = (b - a) / length
    v = np.array([-u[1], u[0]])
    r0, r1 = radius, radius if end_radius is None else end_radius
    half = np.linspace(-np.pi / 2, np.pi / 2, SIDES // 2 + 1)[:, None]
    s = np.linspace(0.0, 1.0, SIDES // 2 if waist < 1.0 else 2)[1:-1, None]
    width = (r0 + (r1 - r0) * s) * (1 - (1 - waist) * np.sin(np.pi * s) ** 2)
    at = a + s * length * u
    return np.concatenate([
        b + r1 * (np.cos(half) * u + np.sin(half) * v), (at + width * v)[::-1],
        a + r0 * (-np.cos(half) * u - np.sin(half) * v), at - width * v])


def _is_closed(faces: NDArray[np.int64]) -> bool:
    """Return whether every edge occurs once in each direction."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = {(int(a), int(b)) for a, b in edges}
    return len(there) == len(edges) and all((b, a) in there for a, b in there)


def _solid(vertices: Array, faces: NDArray[np.int64]) -> TriangleSurface:
    found = clean_surface(vertices, faces)
    if found is None:
        raise ModelError("a solid without a surface")
    return found
