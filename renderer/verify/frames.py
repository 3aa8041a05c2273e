"""What the checks of images share: decoded frames, their pixels, and where these go.

The projections here are the verifier's own (see the package's docstring). A pixel's surface point
moves with its part, so with H = K R inv(K) and e = K t of that motion the target's (u' w, v' w, w)
is z H (u, v, 1) + e. The renderer does not compute flow in this way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..types import Sequence

FLOW = 0.02
"""px: half a step of the encoding in both components is 0.011."""
FLAT = 0.05
"""Share of z: a 2x2 block with a larger spread of depth holds an edge, not a surface."""
METRES = 1e-6
"""m, bound of lengths that only rounding may change."""

Index = NDArray[np.intp]


@dataclass(frozen=True)
class PixelBlock:
    """The 2x2 pixels of a frame around each of M targets."""

    inside: NDArray[np.bool_]
    """[4 M] in the image"""
    same: NDArray[np.bool_]
    """[4 M] in the image and of the target's part"""
    index: Index
    """[4 M] flat index, moved into the image"""
    depth: Array
    """[4 M] m"""
    near: Array
    """[M] m, smallest depth of the target's part; inf if there is none"""
    far: Array
    """[M] m, largest; -inf if there is none"""
    weight: Array
    """[4 M] of bilinear interpolation"""


@dataclass(frozen=True)
class VerifiedFrame:
    """One decoded frame of a sequence; images are flat, N = H W."""

    sequence: Sequence
    t: int
    part: NDArray[np.int64]
    """[N]"""
    depth: Array
    """[N] m"""

    @property
    def unit(self) -> float:
        """m per unit of the depth images."""
        return self.sequence.meta.depth_unit

    def name(self, pixel: int) -> str:
        """Name the place of a flat index."""
        width = self.sequence.meta.width
        return f"frame {self.t} pixel ({pixel % width}, {pixel // width})"

    def positions(self, pixel: Index) -> Array:
        """(u, v) [2 M] px of flat indices [M]."""
        v, u = np.divmod(pixel, self.sequence.meta.width)
        return np.stack([u, v]).astype(np.float64)

    def beyond_border(self, uv: Array) -> Array:
        """[M] px by which positions [2 M] lie outside the image; negative inside."""
        (u, v), meta = uv, self.sequence.meta
        return np.max([-0.5 - u, u - meta.width + 0.5, -0.5 - v, v - meta.height + 0.5], axis=0)

    def around(self, uv: Array, part: NDArray[np.int64]) -> PixelBlock:
        """The pixels around targets [2 M] px of the given parts [M]."""
        width, height = self.sequence.meta.width, self.sequence.meta.height
        u0, v0 = np.floor(uv)
        a, b = uv[0] - u0, uv[1] - v0
        u = np.stack([u0, u0 + 1, u0, u0 + 1])
        v = np.stack([v0, v0, v0 + 1, v0 + 1])
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        index = np.where(inside, v * width + u, 0).astype(np.intp)
        same = inside & (self.part[index] == part)
        depth = self.depth[index]
        return PixelBlock(inside, same, index, depth, np.where(same, depth, np.inf).min(0),
                          np.where(same, depth, -np.inf).max(0),
                          np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b]))


def decode_frame(sequence: Sequence, t: int) -> VerifiedFrame:
    """Decode depth and parts of a frame."""
    return VerifiedFrame(sequence, t, sequence.part[t].ravel().astype(np.int64),
                         sequence.depth[t].ravel().astype(np.float64))


def deforming_numbers(sequence: Sequence) -> NDArray[np.int64]:
    """Part numbers, as in the masks, of the parts with surfaces that deform."""
    meta = sequence.meta
    return np.array([p + 1 for p, name in enumerate(meta.part_names)
                     if name in meta.deforming_parts], np.int64)


@dataclass(frozen=True)
class FlowTargets:
    """Where the surface pixels of a frame are in another frame. M pixels, sorted by part."""

    rest: Index
    """[K] flat index of a background that stands still, as a room does"""
    deforms: Index
    """flat index of the pixels of deforming parts (see deforming.py)"""
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


@dataclass(frozen=True)
class FrameStep:
    """Two consecutive frames and the images that join them; N = H W."""

    here: VerifiedFrame
    there: VerifiedFrame
    motions: Array
    """[P+1 4 4] how each part number moves in the camera frame"""
    forward: NDArray[np.float32] | None
    """[N 2] px; None, as those below, if it is not stored"""
    backward: NDArray[np.float32] | None
    """[N 2] px"""
    visibility: NDArray[np.uint8] | None
    """[N]"""


def flow_targets(frame: VerifiedFrame, motions: Array) -> FlowTargets:
    """Move every surface pixel by its part's motion [P+1 4 4] and project it."""
    k = frame.sequence.state.intrinsics
    k_inverse, half = np.linalg.inv(k), frame.unit / 2
    surface = frame.depth > 0
    groups = [np.flatnonzero(surface & (frame.part == p)) for p in range(len(motions))]
    loose = deforming_numbers(frame.sequence)
    deforms = np.concatenate([groups[0][:0], *(groups[p] for p in loose)])
    for p in loose:
        groups[p] = groups[p][:0]
    stands = np.abs(motions - np.eye(4)).max((-1, -2)) < 1e-12
    rest = groups[0][:0]
    if stands[0]:  # most pixels of a room: what is known of them need not be computed
        rest, groups[0] = groups[0], rest
    numbers = np.repeat(np.arange(len(motions)), [len(g) for g in groups])
    pixel = np.concatenate(groups)
    start, z = frame.positions(pixel), frame.depth[pixel]
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
    return FlowTargets(rest, deforms, pixel, numbers, start, uv, w, slack)
