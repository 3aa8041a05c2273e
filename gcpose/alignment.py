"""What images say of a motion: residuals of moved points, summed into normal equations.

Every residual's derivative is taken to the twist (w, v) of the point's part, T <- exp(twist) T: six
numbers a with dr = -a . twist. So the images enter the estimate only through a 6x6 matrix per part
and frame, whatever the unknowns are: rigid motions, joint angles, axes.

All of them move points by motion [T J+1 4 4] into frames 0..T-1, but for the frame that the points
are from, and add up over each part: matrix [T J+1 6 6], vector [T J+1 6], with Geman-McClure's
weights. Part 0 stands still and says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array
from .kernels import add_flow, add_surface, camera_of, columns
from .surface import Image, Surfaces

Equations = tuple[Array, Array]


@dataclass(frozen=True)
class Elements:
    """Surface elements sorted by part."""

    column: Image
    """[7 N] point, normal, sigma of the distance in m"""
    start: NDArray[np.int64]
    """[J+2] where each part begins."""


def elements(
    point: Array, normal: Array, sigma: Array, label: NDArray[np.int64], parts: int
) -> Elements:
    """Of points and normals [N 3], sigma and label [N] on as many parts."""
    order = np.argsort(label, kind="stable")
    start = np.searchsorted(label[order], np.arange(parts + 1))
    return Elements(columns(point, normal, sigma)[:, order], start)


def sparse(these: Elements, stride: int) -> Elements:
    """Every so manieth of them."""
    return Elements(np.ascontiguousarray(these.column[:, ::stride]), -(-these.start // stride))


def surface_equations(
    surfaces: Surfaces, frame: int, motion: Array, these: Elements
) -> Equations:
    """Point-to-plane distance of the measured surface; projective association.

    A point that has turned to the back of a part meets the front, a part's thickness away: the
    normals tell.
    """
    out = empty(motion.shape)
    add_surface(surfaces.depth, surfaces.normal, camera_of(surfaces.intrinsics, surfaces.depth),
             frame, motion.astype(np.float32), these.column, these.start, *out)
    return out


def flow_equations(
    surfaces: Surfaces, motion: Array, these: Elements, sigma: float, share: float
) -> Equations:
    """Flow from frame t to t + 1 against the motion between (Sec. 3.4, L_w), for t = 0..T-2.

    Twists are of the steps. sigma in px; `share` of the pixels errs independently.
    """
    assert surfaces.flow is not None
    out = empty(motion[1:].shape)
    add_flow(surfaces.depth, surfaces.normal, surfaces.flow,
          camera_of(surfaces.intrinsics, surfaces.depth), motion.astype(np.float32),
          these.column, these.start,
          np.float32(15 * surfaces.noise), np.float32(sigma), np.float32(share), *out)
    return out


def empty(shape: tuple[int, ...]) -> Equations:
    """Sums over nothing yet, for motion of that shape."""
    return np.zeros((*shape[:2], 6, 6)), np.zeros((*shape[:2], 6))
