"""Bundle adjustment (Sec. 3.4) with depth: displacements of many frames, and unknown axes.

The paper minimizes the distance between the places of a part's points under T_theta and in the
images: L_w in pixels, then L_b in brightness over the accumulated point cloud. With depth the
distance is point-to-plane. L_w is added where depth has noise and the search needs a guide. L_b is
not used: on a plain surface that turns, the shading stays with the light. The unknowns are the
displacements theta_{1:n} of all joints and, as far as the knowledge leaves them open, the axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...robots.geometry import Array, inverse
from ..chain import Articulation, HingePrior, add_normal_equations, relative_derivatives
from ..estimator import BundleEquations
from ..images import Surfaces
from .alignment import (
    Surfels,
    accumulate_equations,
    flow_equations,
    sort_surfels,
    surface_equations,
)
from .labels import Cloud, Clouds, part_centers
from .settings import BundleSettings


@dataclass(frozen=True)
class SurfaceResiduals:
    """Distances of key frames' points from the surfaces of all frames (see `Residuals`)."""

    surfaces: Surfaces
    points: Clouds
    hinges: HingePrior
    seen: tuple[Surfels, ...]
    """Of each of the points' frames"""
    settings: BundleSettings

    @property
    def near(self) -> Array:
        """[J 3] a point of the part of each joint"""
        return part_centers(self.points[0], len(self.hinges.point))

    def linearize(
        self, state: Articulation, basis: tuple[Array, ...], scale: float,
        prior: tuple[Array, Array],
    ) -> tuple[BundleEquations, Callable[[Array], SurfaceResiduals]]:
        """Return the equations at a state; the scale is in footprints."""
        matrix, vector, scatter = assemble(self, state, basis, scale)
        smooth, right = prior  # errors of priors are not correlated
        return BundleEquations(matrix + smooth, vector + right, scatter + smooth), lambda _: self


def surface_residuals(
    surfaces: Surfaces, points: Clouds, hinges: HingePrior, settings: BundleSettings
) -> SurfaceResiduals:
    """Return the residuals of labelled points."""
    parts = len(hinges.point) + 1
    seen = tuple(cloud_surfels(surfaces, c, parts, settings.min_part_points) for c in points)
    return SurfaceResiduals(surfaces, points, hinges, seen, settings)


def cloud_surfels(surfaces: Surfaces, cloud: Cloud, parts: int, least: int) -> Surfels:
    """Return the surfels of a cloud, with the standard deviation of a footprint and the noise.

    Those of parts with fewer than `least` points are put on part 0, which is not moved.
    """
    enough = np.bincount(cloud.label, minlength=parts) >= least
    sigma = surfaces.footprint(cloud.point[:, 2]) + surfaces.noise
    label = np.where(enough[cloud.label], cloud.label, 0)
    return sort_surfels(cloud.point, cloud.normal, sigma, label, parts)


def assemble(
    residuals: SurfaceResiduals, state: Articulation, basis: tuple[Array, ...], scale: float
) -> tuple[Array, Array, Array]:
    """Sum the equations of key frames' surfels in all frames: matrix [U U], vector [U] and scatter
    [U U] (see `BundleEquations`).

    A point X of frame s is at T_t T_s^-1 X in frame t: the unknowns of both frames move it.
    """
    surfaces, settings = residuals.surfaces, residuals.settings
    motion = state.motions(len(state.angle))
    derivative = state.derivatives(motion, basis)
    size = derivative.shape[2]
    step_derivative = derivative
    sums = matrix, _, _ = np.zeros((size, size)), np.zeros(size), np.zeros((size, size))
    if surfaces.flow is not None:
        step = motion[1:] @ inverse(motion[:-1])
        step_derivative = relative_derivatives(derivative[1:], step, derivative[:-1])
    for cloud, unscaled in zip(residuals.points, residuals.seen, strict=True):
        frame, surfels = cloud.frame, unscaled.with_scale(scale)
        here_from_there, here = motion @ inverse(motion[frame]), derivative
        if frame:
            here = relative_derivatives(derivative, here_from_there, derivative[frame : frame + 1])
        if surfaces.noise:
            equations, coupling = accumulate_equations(surfaces, here_from_there, surfels, settings)
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
