"""Vertex normals of triangle meshes: those of the file where valid, else by crease angle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .transforms import Array

CREASE = np.deg2rad(35.0)
"""Neighboring facets that meet at less than this are one smooth surface."""

Indices = NDArray[np.int64]


def face_normals(vertices: Array, faces: NDArray[np.integer]) -> tuple[Array, Array]:
    """Unit normals [F 3] and doubled areas [F]; the normal of a degenerate face is zero."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=-1)
    return cross / np.maximum(length, 1e-300)[:, None], length


def weld(vertices: Array) -> Indices:
    """For each vertex [V] the number of its place: vertices at the same point share one."""
    extent = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 1.0
    # 2^20 steps per axis: about the precision of single-precision files, and three fit in 63 bits.
    steps = np.round((vertices - vertices.min(axis=0)) / max(extent, 1e-300) * (2**20 - 1))
    key = steps.astype(np.int64) @ np.array([1 << 42, 1 << 21, 1], np.int64)
    return np.unique(key, return_inverse=True)[1].reshape(-1)


def smooth_corners(
    vertices: Array, faces: Indices, crease: float = CREASE
) -> tuple[Indices, Array]:
    """Smoothing group [F 3] of each face corner, and the unit normal [G 3] of each group.

    Two faces that share an edge and meet at less than `crease` rad share the groups at its ends.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n_faces = len(faces)
    flat, _ = face_normals(vertices, faces)
    place = weld(vertices)[faces]
    start, end = place, np.roll(place, -1, axis=1)
    low, high = np.minimum(start, end).ravel(), np.maximum(start, end).ravel()
    order = np.argsort(low * (int(place.max(initial=0)) + 1) + high, kind="stable")
    first, second = order[:-1], order[1:]
    same = (low[first] == low[second]) & (high[first] == high[second])
    first, second = first[same], second[same]
    alike = np.einsum("ij,ij->i", flat[first // 3], flat[second // 3]) > np.cos(crease)
    first, second = first[alike], second[alike]

    # Corner i of face f is number 3 f + i; half-edge 3 f + i runs from corner i to the next one.
    def next_half_edge(half_edge: Indices) -> Indices:
        return half_edge - half_edge % 3 + (half_edge + 1) % 3

    corners = place.ravel()
    turned = corners[first] == corners[second]  # a neighbor of opposite winding
    links_a = np.concatenate([first, next_half_edge(first)])
    links_b = np.concatenate([np.where(turned, second, next_half_edge(second)),
                              np.where(turned, next_half_edge(second), second)])
    graph = coo_matrix((np.ones(len(links_a), bool), (links_a, links_b)),
                       shape=(3 * n_faces, 3 * n_faces))
    count, group = connected_components(graph, directed=False)
    weight = corner_angles(vertices, faces).ravel()[:, None] * np.repeat(flat, 3, axis=0)
    normals = np.stack([np.bincount(group, weight[:, k], count) for k in range(3)], axis=-1)
    length = np.linalg.norm(normals, axis=-1)
    # Opposite facets of a fold may cancel; any facet of the group then serves.
    fallback = np.zeros((count, 3))
    fallback[group] = np.repeat(flat, 3, axis=0)
    normals = np.where(length[:, None] > 1e-9, normals / np.maximum(length, 1e-300)[:, None],
                       fallback)
    return group.reshape(n_faces, 3).astype(np.int64), normals


def corner_angles(vertices: Array, faces: Indices) -> Array:
    """Angle [F 3] rad of each corner: weights that do not depend on how a polygon was cut."""
    p = vertices[faces]
    to_next = np.roll(p, -1, axis=1) - p
    to_next /= np.maximum(np.linalg.norm(to_next, axis=-1, keepdims=True), 1e-300)
    back = -np.roll(to_next, 1, axis=1)
    return np.arccos(np.clip(np.einsum("fci,fci->fc", to_next, back), -1.0, 1.0))


def valid_normals(vertices: Array, faces: Indices, normals: Array | None) -> bool:
    """Whether a file's normals [V 3] can be kept: finite, not zero, on their faces' side."""
    if normals is None or normals.shape != vertices.shape or not np.isfinite(normals).all():
        return False
    used = normals[faces]  # [F 3 3]
    length = np.linalg.norm(used, axis=-1)
    if (length < 1e-6).any():
        return False
    flat, _ = face_normals(vertices, faces)
    facing = np.einsum("fci,fi->fc", used, flat) > 0.0
    return bool(facing.mean() > 0.95)
