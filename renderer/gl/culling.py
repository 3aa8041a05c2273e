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
    equally often both ways, and faces outward if it and each solid in it enclose a positive
    volume. Its back is never visible from outside, so leaving its back faces out changes no pixel.
    Everything else must be drawn from both sides.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    counts = [len(f) for f in faces]
    if not sum(counts):
        return [np.zeros(n, bool) for n in counts]
    points = np.concatenate(vertices)
    offsets = np.cumsum([0, *(len(v) for v in vertices[:-1])])
    corners = np.concatenate([f + o for f, o in zip(faces, offsets, strict=True)])
    place = _places(points, np.repeat(part, [len(v) for v in vertices]))
    tri, n = place[corners], int(place.max()) + 1
    edges = np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]])
    there, back = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    known, times = np.unique(there, return_counts=True)
    own = np.searchsorted(known, there)
    at = np.minimum(np.searchsorted(known, back), len(known) - 1)
    times_back = np.where(known[at] == back, times[at], 0)
    balanced = times[own] == times_back

    links = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    label = connected_components(links, directed=False)[1][tri[:, 0]]
    is_open = np.zeros(n, bool)
    is_open[np.tile(label, 3)[~balanced]] = True
    at_place = np.empty((n, 3))
    at_place[place] = points
    a, b, c = (at_place[tri[:, i]] for i in range(3))
    share = np.einsum("ij,ij->i", a, np.cross(b, c))
    outward = ~is_open[label] & (np.bincount(label, share, minlength=n)[label] > 0)
    one = np.empty(len(known), np.int64)
    one[own] = np.arange(len(edges))
    mate = np.where((times[own] == 1) & (times_back == 1), one[at], -1)
    most = np.linalg.norm(at_place, axis=1)[tri].prod(1)
    outward &= ~_negative_solids(_solids(edges, mate), share, most)
    return np.split(outward, np.cumsum(counts)[:-1])


def _solids(edges: NDArray[np.int64], mate: NDArray[np.int64]) -> NDArray[np.int64]:
    """[F] a number of the solid of each triangle of a surface that may hold several which touch.

    Edges [3F 2] are the first ones of all triangles, the second ones, the third ones; `mate` [3F]
    is the only edge that runs the other way, or -1. Triangles of such a pair are one solid.
    Where more than two triangles meet at an edge, pieces that are closed by themselves stay apart.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    def join(a: NDArray[np.int64], b: NDArray[np.int64], count: int) -> NDArray[np.int64]:
        links = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
        return connected_components(links, directed=False)[1].astype(np.int64)

    faces = len(edges) // 3
    paired, loose = np.flatnonzero(mate >= 0), np.flatnonzero(mate < 0)
    piece = join(paired % faces, mate[paired] % faces, faces)
    if not len(loose):
        return piece
    ends, owner = np.sort(edges[loose], axis=1), piece[loose % faces]
    line = np.unique(ends @ [int(edges.max()) + 1, 1], return_inverse=True)[1].reshape(-1)
    lines = int(line.max()) + 1
    both, at = np.unique(owner * lines + line, return_inverse=True)
    way = np.sign(edges[loose, 1] - edges[loose, 0])
    uneven = np.bincount(at.reshape(-1), way) != 0
    is_open = np.zeros(faces, bool)
    is_open[both[uneven] // lines] = True
    touching = is_open[owner]
    solid = join(owner[touching], faces + line[touching], faces + lines)
    return solid[piece]


def _negative_solids(solid: NDArray[np.int64], share: Array, most: Array) -> NDArray[np.bool_]:
    """[F] whether the solid of a triangle encloses a negative volume: the sum of `share` [F], whose
    values are at most `most` [F]. Less than rounding leaves is none.
    """
    return (np.bincount(solid, share) < -1e-13 * np.bincount(solid, most))[solid]


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
