"""Bundle adjustment (Sec. 3.4) with depth: displacements of many frames, and unknown axes.

The paper minimizes the distance between the places of a part's points under T_theta and in the
images: L_w in pixels, then L_b in brightness over the accumulated point cloud. With depth the
distance is point-to-plane. L_w is added where depth has noise and the search needs a guide. L_b is
not used: on a plain surface that turns, the shading stays with the light. The unknowns are the
displacements theta_{1:n} of all joints and, as far as the knowledge leaves them open, the axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robots.geometry import Array, inverse
from ..chain import (
    Articulation,
    HingePrior,
    add_normal_equations,
    axis_bases,
    prior_equations,
    relative_derivatives,
    take_step,
)
from ..estimator import BundleEquations
from ..images import Surfaces
from ..numerics import Solver
from .alignment import (
    Surfels,
    accumulate_equations,
    flow_equations,
    sort_surfels,
    surface_equations,
)
from .labels import Cloud, Clouds, part_centers
from .settings import BundleSettings, RgbdSettings

_MIN_STEP = 1e-6  # rad or m; below this, iterations end


@dataclass(frozen=True)
class Views:
    """What a bundle adjustment explains: points of key frames with their parts."""

    surfaces: Surfaces
    clouds: Clouds
    hinges: HingePrior


def assemble(
    surfaces: Surfaces, seen: list[tuple[int, Surfels]], state: Articulation,
    basis: tuple[Array, ...], settings: BundleSettings,
) -> tuple[Array, Array, Array]:
    """Sum the equations of key frames' surfels in all frames: matrix [U U], vector [U] and scatter
    [U U] (see `BundleEquations`).

    A point X of frame s is at T_t T_s^-1 X in frame t: the unknowns of both frames move it.
    """
    motion = state.motions(len(state.angle))
    derivative = state.derivatives(motion, basis)
    size = derivative.shape[2]
    step_derivative = derivative
    sums = matrix, _, _ = np.zeros((size, size)), np.zeros(size), np.zeros((size, size))
    if surfaces.flow is not None:
        step = motion[1:] @ inverse(motion[:-1])
        step_derivative = relative_derivatives(derivative[1:], step, derivative[:-1])
    for frame, surfels in seen:
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


def cloud_surfels(surfaces: Surfaces, cloud: Cloud, parts: int, least: int) -> Surfels:
    """Return the surfels of a cloud, with the standard deviation of a footprint and the noise.

    Those of parts with fewer than `least` points are put on part 0, which is not moved.
    """
    enough = np.bincount(cloud.label, minlength=parts) >= least
    sigma = surfaces.footprint(cloud.point[:, 2]) + surfaces.noise
    label = np.where(enough[cloud.label], cloud.label, 0)
    return sort_surfels(cloud.point, cloud.normal, sigma, label, parts)


def adjust(
    views: Views, state: Articulation, axis_dof: int, scales: tuple[float, ...],
    settings: RgbdSettings, newest: bool = False,
) -> tuple[Articulation, BundleEquations]:
    """Adjust displacements and axes by damped Gauss-Newton; return also the last equations.

    Each revolute axis has `axis_dof` free parameters (see `axis_basis`), each iteration a robust
    scale in footprints. `newest`: only the displacements of the last frame are adjusted.
    """
    joints, near = len(state.twist), part_centers(views.clouds[0], len(state.twist))
    tuned, surfaces = settings.bundle, views.surfaces
    seen = [(c.frame, cloud_surfels(surfaces, c, joints + 1, tuned.min_part_points))
            for c in views.clouds]
    solver = Solver(tuned.damping, tuned.damping_floor, max_step=tuned.max_step)
    equations = BundleEquations(np.zeros((0, 0)), np.zeros(0))
    for scale in scales:
        basis = axis_bases(state, near, 0 if newest else axis_dof)
        matrix, vector, scatter = assemble(
            surfaces, [(f, s.with_scale(scale)) for f, s in seen], state, basis, tuned)
        smooth, right = prior_equations(state, basis, views.hinges, settings.chain)
        equations = BundleEquations(matrix + smooth, vector + right, scatter + smooth)
        frozen = newest & (np.arange(len(vector)) < state.angle[1:-1].size)
        step = solver.step(equations.matrix, equations.vector, frozen)
        state = take_step(state, basis, step)
        if np.abs(step).max() < _MIN_STEP:
            break
    return state, equations
