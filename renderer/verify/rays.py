"""What the checks of images share: a decoded frame, and the pixels around a target in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..types import Sequence

FLOW = 0.02
"""px: half a step of the encoding in both components is 0.011."""
FLAT = 0.05
"""Share of z: a 2x2 block with a larger spread of depth holds an edge, not a surface."""

Index = NDArray[np.intp]


@dataclass(frozen=True)
class View:
    """One decoded frame; images are flat, N = H W."""

    part: NDArray[np.int64]
    depth: Array


@dataclass(frozen=True)
class Block:
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


def block(uv: Array, part: NDArray[np.int64], there: View, width: int, height: int) -> Block:
    """Around targets uv [2 M] px of the given parts [M]."""
    u0, v0 = np.floor(uv)
    a, b = uv[0] - u0, uv[1] - v0
    u = np.stack([u0, u0 + 1, u0, u0 + 1])
    v = np.stack([v0, v0, v0 + 1, v0 + 1])
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    index = np.where(inside, v * width + u, 0).astype(np.intp)
    same = inside & (there.part[index] == part)
    depth = there.depth[index]
    return Block(inside, same, index, depth, np.where(same, depth, np.inf).min(0),
                 np.where(same, depth, -np.inf).max(0),
                 np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b]))


def pixel_name(sequence: Sequence, t: int) -> Callable[[int], str]:
    """The place of a flat index into a frame, in words."""
    width = sequence.meta.width
    return lambda i: f"frame {t} pixel ({i % width}, {i // width})"


def deforming_numbers(sequence: Sequence) -> NDArray[np.int64]:
    """Part numbers, as in the masks, of the parts with surfaces that deform."""
    meta = sequence.meta
    return np.array([p + 1 for p, name in enumerate(meta.part_names)
                     if name in meta.deforming_parts], np.int64)
