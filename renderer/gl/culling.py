"""Which triangles can only be seen from outside: they are drawn one-sided, at half the cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ...robots.model import ArticulatedModel


def outward_faces(
    vertices: Sequence[Array], faces: Sequence[NDArray[np.int32]], part: Sequence[int]
) -> list[NDArray[np.bool_]]:
    """Whether each triangle, [F] per mesh, belongs to a closed surface that faces outward.

    The meshes ([V 3] m and [F 3]) are pieces of rigid parts, numbers that ascend: vertices of a
    part at one place are one vertex. A connected surface is closed if each edge is run through
    equally often both ways, and faces outward if it encloses a positive volume. Its back is never
    visible from outside, so leaving its back faces out changes no pixel. Everything else must be
    drawn from both sides.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    counts = [len(f) for f in faces]
    if not sum(counts):
        return [np.zeros(n, bool) for n in counts]
    points = np.concatenate(vertices)
    offsets = np.cumsum([0, *(len(v) for v in vertices[:-1])])
    corners = np.concatenate([f + o for f, o in zip(faces, offsets, strict=True)])
    tri = _places(points, np.repeat(part, [len(v) for v in vertices]))[corners]
    n = int(tri.max()) + 1
    edges = np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]])
    there, back = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    known, times = np.unique(there, return_counts=True)
    at = np.minimum(np.searchsorted(known, back), len(known) - 1)
    times_back = np.where(known[at] == back, times[at], 0)
    balanced = times[np.searchsorted(known, there)] == times_back

    links = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    label = connected_components(links, directed=False)[1][tri[:, 0]]
    is_open = np.zeros(n, bool)
    is_open[np.tile(label, 3)[~balanced]] = True
    a, b, c = (points[corners[:, i]] for i in range(3))
    volume = np.bincount(label, np.einsum("ij,ij->i", a, np.cross(b, c)), minlength=n)
    outward = ~is_open[label] & (volume[label] > 0)
    return np.split(outward, np.cumsum(counts)[:-1])


def _places(points: Array, part: NDArray[np.int64]) -> NDArray[np.int64]:
    """[V] a number of the place of each point [V 3] of a part [V], which ascends; points of a part
    within a millionth of its extent share one.
    """
    first = np.flatnonzero(np.diff(part, prepend=part[0] - 1))
    count = np.diff(first, append=len(part))
    extent = np.maximum.reduceat(points, first) - np.minimum.reduceat(points, first)
    grid = np.maximum(extent.max(1) * 1e-6, 1e-12)
    steps = np.round(points / np.repeat(grid, count)[:, None]).astype(np.int64)
    steps -= np.repeat(np.minimum.reduceat(steps, first), count, axis=0)  # at most a million each
    key = steps @ np.array([1 << 40, 1 << 20, 1])
    order = np.lexsort((key, part))
    place = np.empty(len(part), np.int64)
    place[order] = np.cumsum((np.diff(part[order], prepend=part[0]) != 0)
                             | (np.diff(key[order], prepend=key[order[0]]) != 0))
    return place


def find_one_sided(model: ArticulatedModel) -> list[NDArray[np.bool_]]:
    """For each visual, which of its triangles [F] are seen from outside only.

    None of one that deforms, which may turn inside out, or in which alpha cuts holes.
    """
    out = [np.zeros(len(v.faces), bool) for v in model.visuals]
    chosen = [k for k, v in enumerate(model.visuals)
              if not v.deforms and v.material.alpha_cutoff is None]
    chosen.sort(key=lambda k: model.visuals[k].part)
    visuals = [model.visuals[k] for k in chosen]
    found = outward_faces([v.vertices for v in visuals], [v.faces for v in visuals],
                          [v.part for v in visuals])
    for k, outward in zip(chosen, found, strict=True):
        out[k] = outward
    return out
