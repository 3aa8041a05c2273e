"""Bundle adjustment (Sec. 3.4) with depth: joint displacements of many frames and unknown axes.

The paper minimises the distance between where a part's points fall under T_theta and where the
images show them: L_w in pixels, then L_b in brightness over the accumulated point cloud. With
depth the distance is point-to-plane, and L_w joins it where depth is noisy and the search needs to
be led; L_b would not help: shades stay with the lamp where a plain surface turns. The unknowns are
the displacements theta_{1:n} of all joints and, where the knowledge leaves them open, the axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...robots.geometry import Array, inverse
from ..chain import (
    Articulation,
    Cloud,
    Hinges,
    Normal,
    add_normal,
    axis_bases,
    closeness,
    displaced,
    relative,
    smoothness,
)
from ..images import Surfaces
from ..numerics import Solver
from .alignment import (
    Elements,
    Equations,
    accumulated_equations,
    elements,
    flow_equations,
    surface_equations,
)
from .settings import BundleSettings, RgbdSettings


@dataclass(frozen=True)
class Views:
    """What a bundle adjustment explains."""

    surfaces: Surfaces
    clouds: tuple[Cloud, ...]
    """Points of key frames with their parts."""
    hinges: Hinges


@dataclass(frozen=True)
class Sums:
    """Normal equations of U unknowns: displacements of frames 1.., then the axes'."""

    matrix: Array
    """[U U]"""
    vector: Array
    """[U]"""
    scatter: Array
    """[U U] sum of the outer products of each cloud's, part's and frame's vector: the covariance
    of `vector` if what errs errs together there."""

    @staticmethod
    def nothing(size: int) -> Sums:
        """Of as many unknowns."""
        return Sums(np.zeros((size, size)), np.zeros(size), np.zeros((size, size)))

    def add(self, equations: Equations, g: Array) -> None:
        """Of parts and frames, whose twists are g [T J+1 U 6] per unknown."""
        add_normal(*equations, g, self.matrix, self.vector, self.scatter)

    def believe(self, belief: Normal, these: slice) -> None:
        """What is believed of some of the unknowns."""
        self.matrix[these, these] += belief.matrix
        self.scatter[these, these] += belief.matrix
        self.vector[these] += belief.vector


def assemble(
    surfaces: Surfaces,
    seen: list[tuple[int, Elements]],
    state: Articulation,
    basis: tuple[Array, ...],
    scale: float,
    settings: BundleSettings,
) -> Sums:
    """Elements of key frames against all frames; `scale` is in footprints of a pixel.

    A point of frame s is at T_t T_s^-1 X in frame t: both frames' unknowns move it.
    """
    motion = state.motions(len(state.angle))
    derivative = state.derivatives(motion, basis)
    size = derivative.shape[2]
    sums, by_step = Sums.nothing(size), derivative
    if surfaces.flow is not None:
        step = motion[1:] @ inverse(motion[:-1])
        by_step = relative(derivative[1:], step, derivative[:-1])
    for frame, unscaled in seen:
        these = unscaled.scaled(scale)
        here_from_there = motion @ inverse(motion[frame])
        g = derivative
        if frame:
            g = relative(derivative, here_from_there, derivative[frame : frame + 1])
        if surfaces.noise:
            six, right, coupling = accumulated_equations(surfaces, here_from_there, these,
                                                         settings)
            sums.add((six, right), g)
            for part, c in zip(g.swapaxes(0, 1), coupling, strict=True):
                along = part.swapaxes(1, 2).reshape(-1, size)
                sums.matrix[:] -= along.T @ c @ along
        else:
            sums.add(surface_equations(surfaces, frame, here_from_there, these, settings), g)
        if surfaces.flow is not None:
            sums.add(flow_equations(surfaces, here_from_there, these, settings), by_step)
    return sums


def elements_of(surfaces: Surfaces, cloud: Cloud, parts: int, least: int) -> Elements:
    """A cloud's, with what a pixel's footprint and noise leave uncertain; parts with fewer than
    `least` points do not count."""
    many = np.bincount(cloud.label, minlength=parts) >= least
    sigma = surfaces.footprint(cloud.point[:, 2]) + surfaces.noise
    label = np.where(many[cloud.label], cloud.label, 0)
    return elements(cloud.point, cloud.normal, sigma, label, parts)


def adjust(
    views: Views, state: Articulation, freedom: int, scales: tuple[float, ...],
    settings: RgbdSettings, newest: bool = False,
) -> tuple[Articulation, Sums]:
    """Gauss-Newton over the state's frames, an iteration for each of `scales` (footprints).

    With `newest` only the last frame's displacements move. Returns the articulation and the
    equations of the last iteration.
    """
    joints, last = len(state.twist), len(state.angle) - 1
    held = last * joints
    tuned, surfaces = settings.bundle, views.surfaces
    seen = [(c.frame, elements_of(surfaces, c, joints + 1, tuned.min_part_points))
            for c in views.clouds]
    solver = Solver(tuned.damping, tuned.damping_floor, max_step=tuned.max_step)
    sums = Sums.nothing(0)
    for scale in scales:
        basis = axis_bases(state, views.clouds, 0 if newest else freedom)
        sums = assemble(surfaces, seen, state, basis, scale, tuned)
        sums.believe(smoothness(state.angle, last, settings.chain), slice(0, held))
        sums.believe(closeness(state, basis, views.hinges), slice(held, None))
        frozen = newest & (np.arange(len(sums.vector)) < held - joints)
        step = solver.step(sums.matrix, sums.vector, frozen)
        angle = state.angle.copy()
        angle[1:] += step[:held].reshape(last, joints)
        state = replace(state, angle=angle, twist=displaced(state, basis, step[held:]))
        if np.abs(step).max() < 1e-6:
            break
    return state, sums


def deviation(sums: Sums, frames: int, joints: int) -> Array:
    """[T J] standard deviation of displacements: H^-1 S H^-1, S the scatter of what pulls at
    them."""
    out, held = np.zeros((frames, joints)), (frames - 1) * joints
    inverse_hessian = np.linalg.inv(sums.matrix + 1e-6 * np.eye(len(sums.matrix)))
    variance = np.diag(inverse_hessian @ sums.scatter @ inverse_hessian)[:held]
    out[1:] = np.sqrt(np.maximum(variance, 0.0)).reshape(frames - 1, joints)
    return out
