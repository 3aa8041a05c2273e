"""Where the surface of each pixel is in another frame, from geometry alone.

A pixel's surface point moves with its part, so with H = K R inv(K) and e = K t of that motion the
target's (u' w, v' w, w) is z H (u, v, 1) + e. This is not the way the renderer computes flow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..types import Sequence
from .rays import Index, View, deforming_numbers


@dataclass(frozen=True)
class Targets:
    """Where the surface pixels of a frame are in another frame. M pixels, sorted by part."""

    rest: Index
    """[K] flat index of a background that stands still, as a room does"""
    deforms: Index
    """flat index of the pixels of deforming parts, which verify_deforming.py looks at"""

    pixel: Index
    """[M] flat index"""
    part: NDArray[np.int64]
    """[M]"""
    start: Array
    """[2 M] px, the pixel itself"""
    uv: Array
    """[2 M] px"""
    z: Array
    """[M] m, not positive behind the camera"""
    slack: Array
    """[2 M] px, change of uv for half a unit of depth"""


def targets_of(sequence: Sequence, view: View, motions: Array, parts: int) -> Targets:
    """Every surface pixel, moved by its part's motion [P+1 4 4] and projected."""
    k = sequence.state.intrinsics
    k_inverse, half = np.linalg.inv(k), sequence.meta.depth_unit / 2
    surface = view.depth > 0
    groups = [np.flatnonzero(surface & (view.part == p)) for p in range(parts + 1)]
    loose = deforming_numbers(sequence)
    deforms = np.concatenate([groups[0][:0], *(groups[p] for p in loose)])
    for p in loose:
        groups[p] = groups[p][:0]
    stands = np.abs(motions - np.eye(4)).max((-1, -2)) < 1e-12
    rest = groups[0][:0]
    if stands[0]:  # most pixels of a room: what is known of them need not be computed
        rest, groups[0] = groups[0], rest
    numbers = np.repeat(np.arange(parts + 1), [len(g) for g in groups])
    pixel = np.concatenate(groups)
    v, u = np.divmod(pixel, sequence.meta.width)
    start, z = np.stack([u, v]).astype(np.float64), view.depth[pixel]
    uv, w, slack = start.copy(), z.copy(), np.zeros_like(start)
    end = 0
    for p, group in enumerate(groups):
        begin, end = end, end + len(group)
        if begin == end or stands[p]:
            continue
        i = slice(begin, end)
        h, e = k @ motions[p, :3, :3] @ k_inverse, k @ motions[p, :3, 3]
        ray = h[:, :2] @ start[:, i] + h[:, 2:]
        moved = ray * z[i] + e[:, None]
        w[i] = moved[2]
        uv[:, i] = moved[:2] / moved[2]
        slack[:, i] = half * np.abs(ray[:2] * e[2] - ray[2] * e[:2, None]) / moved[2] ** 2
    return Targets(rest, deforms, pixel, numbers, start, uv, w, slack)
