"""Residuals of moved points, summed into normal equations of their parts' twists.

The derivative of every residual is taken to the twist (w, v) of the point's part, T <- exp(twist)
T: six numbers a with dr = -a . twist. So the images enter the estimate only through a 6x6 matrix
per part and frame, whatever the unknowns are: rigid motions, joint angles, or axes.

All functions move points by `motion` [T J+1 4 4] into frames 0..T-1, except the points' own, and
sum over each part: matrix [T J+1 6 6] and vector [T J+1 6] of residuals in standard deviations,
with Geman-McClure's weights (see numerics/robust.py). Part 0 is static and has no equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..images import Surfaces
from ..numerics import Image
from .kernels import add_flow, add_surface, columns, fill_plane_rows, flat_camera
from .settings import BundleSettings

PartEquations = tuple[Array, Array]
"""matrix [T J+1 6 6] and vector [T J+1 6]"""


@dataclass(frozen=True)
class Surfels:
    """Surface elements sorted by part (Pfister et al., Surfels, SIGGRAPH 2000)."""

    column: Image
    """[7 N] point and normal (camera frame, m), standard deviation of the distance (m)"""
    start: NDArray[np.int64]
    """[J+2] where each part begins"""

    def with_scale(self, scale: float) -> Surfels:
        """Return the same with the standard deviations times `scale`."""
        column = self.column.copy()
        column[6] *= np.float32(scale)
        return Surfels(column, self.start)


def sort_surfels(
    point: Array, normal: Array, sigma: Array, label: NDArray[np.int64], parts: int
) -> Surfels:
    """Sort points and normals [N 3] with standard deviations and labels [N] by part."""
    order = np.argsort(label, kind="stable")
    start = np.searchsorted(label[order], np.arange(parts + 1))
    return Surfels(columns(point, normal, sigma)[:, order], start)


def thin_surfels(surfels: Surfels, stride: int) -> Surfels:
    """Return every `stride`-th surfel."""
    column = np.ascontiguousarray(surfels.column[:, ::stride])
    return Surfels(column, -(-surfels.start // stride))


def surface_equations(
    surfaces: Surfaces, frame: int, motion: Array, surfels: Surfels, settings: BundleSettings
) -> PartEquations:
    """Sum point-to-plane distances from the measured surfaces, by projective association (Chen and
    Medioni, 1991; Blais and Levine, 1995).

    A point that has turned to the back of its part projects onto the front, a part's thickness
    away. Such matches are rejected by their normals.
    """
    out = zero_equations(motion.shape)
    add_surface(surfaces.depth, surfaces.normal, flat_camera(surfaces), frame,
                motion.astype(np.float32), surfels.column, surfels.start,
                np.float32(settings.min_normal_cosine), *out)
    return out


def accumulate_equations(
    surfaces: Surfaces, motion: Array, surfels: Surfels, settings: BundleSettings
) -> tuple[PartEquations, Array]:
    """Sum distances of measured surfaces from points that may be displaced along their normals.

    The error of a noisy point is the same in all frames, and its match depends on that error: both
    bias displacements toward zero. So each point has an unknown displacement, which is eliminated
    by a Schur complement (Triggs et al., Bundle adjustment - a modern synthesis, 2000, section 6).
    That couples the frames. The points' own frame is one of them.

    Returns:
        The equations, and the coupling [J+1 6T 6T] to be subtracted from the matrix of each part.
    """
    frames, parts = motion.shape[:2]
    n = surfels.column.shape[1]
    row, residual = np.zeros((frames, 6, n), np.float32), np.zeros((frames, n), np.float32)
    weight = np.zeros((frames, n), np.float32)
    fill_plane_rows(surfaces.depth, surfaces.normal, flat_camera(surfaces),
                    motion.astype(np.float32), surfels.column, surfels.start,
                    np.float32(settings.min_normal_cosine), row, residual, weight)
    total = np.maximum(weight.sum(axis=0), np.float32(1e-12))
    residual -= (weight * residual).sum(axis=0) / total
    matrix, vector = zero_equations(motion.shape)
    coupling = np.zeros((parts, 6 * frames, 6 * frames))
    for j in range(1, parts):
        mine = slice(surfels.start[j], surfels.start[j + 1])
        a = row[:, :, mine]
        weighted = a * weight[:, None, mine]
        matrix[:, j] = weighted @ a.transpose(0, 2, 1)
        vector[:, j] = np.einsum("tan,tn->ta", weighted, residual[:, mine])
        flat = weighted.reshape(6 * frames, -1)
        coupling[j] = (flat / total[mine]) @ flat.T
    return (matrix, vector), coupling


def flow_equations(
    surfaces: Surfaces, motion: Array, surfels: Surfels, settings: BundleSettings
) -> PartEquations:
    """Sum differences between the flow from frame t to t + 1 and the motion (Sec. 3.4, L_w), for
    t = 0..T-2.

    Twists are of the steps between frames. One in `settings.flow_stride` surfels is compared.
    """
    assert surfaces.flow is not None
    some = thin_surfels(surfels, settings.flow_stride)
    out = zero_equations(motion[1:].shape)
    add_flow(surfaces.depth, surfaces.normal, surfaces.flow, flat_camera(surfaces),
             motion.astype(np.float32), some.column, some.start,
             np.float32(settings.flow_depth_noise * surfaces.noise),
             np.float32(settings.flow_sigma),
             np.float32(settings.flow_share * settings.flow_stride), *out)
    return out


def zero_equations(shape: tuple[int, ...]) -> PartEquations:
    """Return equations without residuals, for motions of a shape."""
    return np.zeros((*shape[:2], 6, 6)), np.zeros((*shape[:2], 6))
