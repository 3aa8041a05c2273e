"""Bundle adjustment (Sec. 3.4) with depth: residuals of moved points, and their normal equations.

The paper minimizes the distance between the places of a part's points under T_theta and in the
images: L_w in pixels, then L_b in brightness over the accumulated point cloud. With depth the
distance is point-to-plane. L_w is added where depth has noise and the search needs a guide. L_b is
not used: on a plain surface that turns, the shading stays with the light.

The derivative of every residual is taken to the twist (w, v) of the point's part, T <- exp(twist)
T: six numbers a with dr = -a . twist. So the images enter the estimate only through a 6x6 matrix
per part and frame, whatever the unknowns are: rigid motions, joint angles, or axes.

All functions move points by `motion` [T J+1 4 4] into frames 0..T-1, except the points' own, and
sum over each part: matrix [T J+1 6 6] and vector [T J+1 6] of residuals in standard deviations,
with Geman-McClure's weights (see numerics/robust.py). Part 0 is static and has no equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, inverse
from ..chain import Articulation, add_normal_equations, relative_derivatives
from ..estimator import BundleEquations
from ..images import Surfaces
from ..numerics import Image
from .kernels import add_flow, add_surface, columns, fill_plane_rows, flat_camera
from .labels import Cloud, Clouds
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
        if mine.start == mine.stop:
            continue  # np.einsum reads memory even of no points, and NaN in it makes NaN
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


@dataclass(frozen=True)
class SurfaceResiduals:
    """Distances of key frames' points from the surfaces of all frames (see `Residuals`)."""

    surfaces: Surfaces
    points: Clouds
    surfels: tuple[Surfels, ...]
    """The same, sorted"""
    settings: BundleSettings

    def linearize(
        self, state: Articulation, basis: tuple[Array, ...], scale: float,
        prior: tuple[Array, Array],
    ) -> tuple[BundleEquations, Callable[[Array], SurfaceResiduals]]:
        """Return the equations at a state; the scale is in footprints."""
        matrix, vector, scatter = self._assemble(state, basis, scale)
        smooth, right = prior  # errors of priors are not correlated
        return BundleEquations(matrix + smooth, vector + right, scatter + smooth), lambda _: self

    def _assemble(
        self, state: Articulation, basis: tuple[Array, ...], scale: float
    ) -> tuple[Array, Array, Array]:
        """Matrix [U U], vector [U] and scatter [U U] of key frames' surfels in all frames.

        A point X of frame s is at T_t T_s^-1 X in frame t: the unknowns of both frames move it.
        """
        surfaces, settings = self.surfaces, self.settings
        motion = state.motions(len(state.angle))
        derivative = state.derivatives(motion, basis)
        size = derivative.shape[2]
        step_derivative = derivative
        sums = matrix, _, _ = np.zeros((size, size)), np.zeros(size), np.zeros((size, size))
        if surfaces.flow is not None:
            step = motion[1:] @ inverse(motion[:-1])
            step_derivative = relative_derivatives(derivative[1:], step, derivative[:-1])
        for cloud, unscaled in zip(self.points, self.surfels, strict=True):
            frame, surfels = cloud.frame, unscaled.with_scale(scale)
            here_from_there, here = motion @ inverse(motion[frame]), derivative
            if frame:
                here = relative_derivatives(
                    derivative, here_from_there, derivative[frame : frame + 1])
            if surfaces.noise:
                equations, coupling = accumulate_equations(
                    surfaces, here_from_there, surfels, settings)
                add_normal_equations(*equations, here, *sums)
                for part, c in zip(here.swapaxes(0, 1), coupling, strict=True):
                    along = part.swapaxes(1, 2).reshape(-1, size)
                    matrix -= along.T @ c @ along
            else:
                equations = surface_equations(surfaces, frame, here_from_there, surfels, settings)
                add_normal_equations(*equations, here, *sums)
            if surfaces.flow is not None:
                equations = flow_equations(surfaces, here_from_there, surfels, settings)
                add_normal_equations(*equations, step_derivative, *sums)
        return sums


def cloud_surfels(surfaces: Surfaces, cloud: Cloud, parts: int, least: int) -> Surfels:
    """Return the surfels of a cloud, with the standard deviation of a footprint and the noise.

    Those of parts with fewer than `least` points are put on part 0, which is not moved.
    """
    enough = np.bincount(cloud.label, minlength=parts) >= least
    sigma = surfaces.footprint(cloud.point[:, 2]) + surfaces.noise
    label = np.where(enough[cloud.label], cloud.label, 0)
    return sort_surfels(cloud.point, cloud.normal, sigma, label, parts)
