"""Bundle adjustment (Sec. 3.4) with depth: joint displacements of many frames and unknown axes.

The paper minimises the distance between where a part's points fall under T_theta and where the
images show them: L_w in pixels, then L_b in brightness over the accumulated point cloud. With
depth the distance is point-to-plane, and L_w joins it where depth is noisy and the search needs to
be led; L_b would not help: shades stay with the lamp where a plain surface turns. The unknowns are
the displacements theta_{1:n} of all joints and, where the knowledge leaves them open, the axes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..robots.geometry import Array, inverse
from .alignment import (
    Equations,
    accumulated_equations,
    elements,
    flow_equations,
    sparse,
    surface_equations,
)
from .articulation import Articulation, Cloud, axis_bases, derivatives, displaced
from .chain import adjoint
from .prior import Hinges, Normal, closeness, smoothness
from .surface import Surfaces

_STEP = 0.15  # largest change of an unknown in an iteration, rad or m
_DAMPING = 1e-6  # of the diagonal; more, and flat valleys take hundreds of steps
_FEWEST = 6  # points of a part that count
_FLOW_SCALE = 1.0  # px, of flow's errors
_FLOW_SHARE = 0.05  # of its pixels that err independently
_FLOW_STRIDE = 2  # of the points whose flow is looked at: neighbours' errors are alike


def assemble(
    surfaces: Surfaces,
    clouds: tuple[Cloud, ...],
    state: Articulation,
    basis: tuple[Array, ...],
    last: int,
    scale: float,
) -> Normal:
    """Clouds against all frames up to `last`; `scale` is in footprints of a pixel.

    A point of frame s is at T_t T_s^-1 X in frame t: both frames' unknowns move it.
    """
    motion = state.motions(last + 1)
    derivative = derivatives(state, motion, basis)
    size = derivative.shape[-1]
    matrix, vector, scatter = np.zeros((size, size)), np.zeros(size), np.zeros((size, size))

    def add(equations: Equations, g: Array) -> None:
        """Sums over parts and frames, of twists that are g [T J+1 6 U] per unknown."""
        six, right = equations
        each = np.einsum("tji,tjiu->tju", right, g).reshape(-1, size)
        g = g.reshape(-1, 6, size)
        along = (six.reshape(-1, 6, 6) @ g).reshape(-1, size)
        np.add(matrix, g.reshape(-1, size).T @ along, out=matrix)
        np.add(vector, each.sum(axis=0), out=vector)
        np.add(scatter, each.T @ each, out=scatter)

    for cloud in clouds:
        many = np.bincount(cloud.label, minlength=len(state.twist) + 1) >= _FEWEST
        label = np.where(many[cloud.label], cloud.label, 0)
        here_from_there = motion @ inverse(motion[cloud.frame])
        g = derivative
        if cloud.frame:
            g = g - adjoint(here_from_there) @ derivative[cloud.frame]
        sigma = scale * (surfaces.footprint(cloud.point[:, 2]) + surfaces.noise)
        parts = len(state.twist) + 1
        these = elements(cloud.point, cloud.normal, sigma, label, parts)
        if surfaces.noise:
            six, right, coupling = accumulated_equations(surfaces, here_from_there, these)
            add((six, right), g)
            for part, c in zip(g.swapaxes(0, 1), coupling, strict=True):
                along = part.reshape(-1, size)
                matrix -= along.T @ c @ along
        else:
            add(surface_equations(surfaces, cloud.frame, here_from_there, these), g)
        if surfaces.flow is not None:
            some = sparse(these, _FLOW_STRIDE)
            step = motion[1:] @ inverse(motion[:-1])
            add(flow_equations(surfaces, here_from_there, some, _FLOW_SCALE,
                               _FLOW_SHARE * _FLOW_STRIDE),
                derivative[1:] - adjoint(step) @ derivative[:-1])
    return Normal(matrix, vector, scatter)


def adjust(
    surfaces: Surfaces,
    clouds: tuple[Cloud, ...],
    state: Articulation,
    freedom: int,
    scales: tuple[float, ...],
    hinges: Hinges,
    newest: bool = False,
) -> tuple[Articulation, Array]:
    """Gauss-Newton over the state's frames, an iteration for each of `scales` (footprints).

    With `newest` only the last frame's displacements move. Returns the articulation and the
    standard deviation of its displacements [T J].
    """
    joints, last = len(state.twist), len(state.angle) - 1
    held = last * joints
    hessian, scatter = np.zeros((0, 0)), np.zeros((0, 0))
    for scale in scales:
        basis = axis_bases(state, clouds, 0 if newest else freedom)
        n = assemble(surfaces, clouds, state, basis, last, scale)
        prior = smoothness(state.angle, last)
        assert n.scatter is not None
        scatter = n.scatter.copy()
        scatter[:held, :held] += prior.matrix
        n.matrix[:held, :held] += prior.matrix
        n.vector[:held] += prior.vector
        belief = closeness(state, basis, hinges)
        n.matrix[held:, held:] += belief.matrix
        scatter[held:, held:] += belief.matrix
        n.vector[held:] += belief.vector
        hessian = n.matrix
        damping = _DAMPING * np.diag(n.matrix) + 1.0
        if newest:
            damping[: held - joints] += 1e15
        step = np.linalg.solve(n.matrix + np.diag(damping), n.vector)
        step = np.asarray(np.clip(step, -_STEP, _STEP), np.float64)
        angle = state.angle.copy()
        angle[1:] += step[:held].reshape(last, joints)
        state = replace(state, angle=angle, twist=displaced(state, basis, step[held:]))
        if np.abs(step).max() < 1e-6:
            break
    return state, deviation(hessian, scatter, last, joints)


def deviation(hessian: Array, scatter: Array, last: int, joints: int) -> Array:
    """[T J] of the displacements: H^-1 S H^-1, S the scatter of what pulls at them."""
    out = np.zeros((last + 1, joints))
    inverse_hessian = np.linalg.inv(hessian + 1e-6 * np.eye(len(hessian)))
    variance = np.diag(inverse_hessian @ scatter @ inverse_hessian)[: last * joints]
    out[1:] = np.sqrt(np.maximum(variance, 0.0)).reshape(last, joints)
    return out
