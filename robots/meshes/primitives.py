"""Box, sphere, cylinder and capsule with analytic normals and UVs, centred, axis along z."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ...errors import ModelError
from ..geometry import Array
from ..model import TriangleSurface

AROUND = 64
"""Facets around a full turn: off the true circle by 0.12 % of the radius."""


def box(size: Sequence[float]) -> TriangleSurface:
    """A box of edge lengths `size` m."""
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
    """A sphere of `radius` m."""
    _positive("sphere", [radius])
    polar = np.linspace(np.pi, 0.0, AROUND // 2 + 1)
    return revolved(radius * np.sin(polar), radius * np.cos(polar), np.sin(polar), np.cos(polar))


def cylinder(radius: float, length: float) -> TriangleSurface:
    """A closed cylinder of `radius` and `length` m."""
    _positive("cylinder", [radius, length])
    h = length / 2.0
    parts = [
        revolved([0.0, radius], [-h, -h], [0.0, 0.0], [-1.0, -1.0]),
        revolved([radius, radius], [-h, h], [1.0, 1.0], [0.0, 0.0]),
        revolved([radius, 0.0], [h, h], [0.0, 0.0], [1.0, 1.0]),
    ]
    return joined(parts)


def capsule(radius: float, length: float) -> TriangleSurface:
    """A cylinder of `radius` and `length` m with half a sphere on either end."""
    _positive("capsule", [radius])
    if length < 0:
        raise ModelError(f"capsule of length {length}: sizes must not be negative")
    polar = np.linspace(np.pi, 0.0, AROUND // 2 + 1)
    lower, upper = polar[: AROUND // 4 + 1], polar[AROUND // 4:]
    both = np.concatenate([lower, upper] if length else [polar])
    shift = np.where(np.arange(len(both)) < len(lower), -length / 2.0, length / 2.0)
    return revolved(radius * np.sin(both), radius * np.cos(both) + shift,
                     np.sin(both), np.cos(both))


def revolved(
    r: ArrayLike, z: ArrayLike, normal_r: ArrayLike, normal_z: ArrayLike
) -> TriangleSurface:
    """The profile (r, z), from below upwards on the outside, turned about the z axis."""
    r, z, nr, nz = (np.asarray(x, np.float64) for x in (r, z, normal_r, normal_z))
    r = np.where(np.abs(r) < 1e-12 * max(float(np.abs(r).max()), 1e-300), 0.0, r)
    rings, columns = len(r), AROUND + 1  # the seam has both u = 0 and u = 1
    turn = np.linspace(0.0, 2.0 * np.pi, columns)
    c, s = np.cos(turn), np.sin(turn)
    c[-1], s[-1] = c[0], s[0]
    ones = np.ones(columns)
    vertices = np.stack([np.outer(r, c), np.outer(r, s), np.outer(z, ones)], axis=-1)
    normals = np.stack([np.outer(nr, c), np.outer(nr, s), np.outer(nz, ones)], axis=-1)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(r), np.diff(z)))])
    uv = np.stack(np.meshgrid(np.linspace(0.0, 1.0, columns), along / along[-1]), axis=-1)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(rings - 1), np.arange(AROUND), indexing="ij"))
    a, b, c0, d = i * columns + j, i * columns + j + 1, (i + 1) * columns + j + 1, (
        i + 1) * columns + j
    below, above = r[i] > 0, r[i + 1] > 0  # no triangle of zero width at a pole
    faces = np.concatenate([np.stack([a, b, c0], -1)[below], np.stack([a, c0, d], -1)[above]])
    return TriangleSurface(
        vertices.reshape(-1, 3), faces, normals.reshape(-1, 3), uv.reshape(-1, 2))


def joined(parts: Sequence[TriangleSurface]) -> TriangleSurface:
    counts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    uvs: list[Array] = [p.uv for p in parts if p.uv is not None]
    return TriangleSurface(np.concatenate([p.vertices for p in parts]),
                   np.concatenate([p.faces + n for p, n in zip(parts, counts, strict=False)]),
                   np.concatenate([p.normals for p in parts]), np.concatenate(uvs))


def _positive(kind: str, sizes: Sequence[float]) -> None:
    if not all(np.isfinite(s) and s > 0 for s in sizes):
        shown = " ".join(f"{s:g}" for s in sizes)
        raise ModelError(f"{kind} of size {shown}: sizes must be positive numbers of metres")
