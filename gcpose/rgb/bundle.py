"""Bundle adjustment without depth (Sec. 3.4): displacements, axes and the depth of every point.

A point is a pixel of a key frame and an unknown inverse depth; the chain takes it to the other
frames, where the flow says how it goes on. Each residual touches the unknowns through the twists of
its part and through the point's own depth; depths are eliminated (Schur's complement), so that a
step costs little more than with depth known. Scale is free: depths are about 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, inverse
from ..chain import (
    Articulation,
    ChainSettings,
    Hinges,
    axis_basis,
    closeness,
    displaced,
    relative,
    smoothness,
)
from .kernels import accumulate
from .points import Rays

_STEP = 0.15  # largest change of an unknown in an iteration, rad or m
_NEAREST, _FARTHEST = 2.5, 0.4  # of inverse depths
_ROUGH = 0.1  # standard deviation of a point's inverse depth from those of its neighbours


@dataclass(frozen=True)
class Fit:
    """What an adjustment leaves."""

    state: Articulation
    inverse_depth: Array
    """[N]"""
    hessian: Array
    """[U U] of displacements and axes, depths eliminated"""


def adjust_rays(
    state: Articulation,
    rays: Rays,
    intrinsics: Array,
    freedom: int,
    scales: tuple[float, ...],
    hinges: Hinges,
    belief: float = 1.0,
    spread: float = 0.5,
) -> Fit:
    """Gauss-Newton, an iteration for each of `scales` (standard deviations that are believed).

    `belief` is the weight of what is believed beforehand of the motion and the axes, `spread` the
    standard deviation of inverse depths: loose in the end, for they err together.
    """
    frames, joints = state.angle.shape
    held = (frames - 1) * joints
    depth = rays.inverse_depth.copy()
    hessian = np.zeros((0, 0))
    blocks = _roughness(rays)
    for scale in scales:
        basis = tuple(
            axis_basis(state.twist[j], bool(state.prismatic[j]), hinges.point[j], freedom)
            for j in range(joints)
        )
        matrix, vector, coupling, h, g = _assemble(
            state, replace(rays, inverse_depth=depth), intrinsics, basis, scale
        )
        prior = smoothness(state.angle, frames - 1, ChainSettings())
        matrix[:held, :held] += belief * prior.matrix
        vector[:held] += belief * prior.vector
        near = closeness(state, basis, hinges)
        matrix[held:, held:] += belief * near.matrix
        vector[held:] += belief * near.vector
        h = h + 1 / spread**2
        g = g + (rays.expected - depth) / spread**2
        by_depth = np.empty_like(coupling)
        alone = np.empty_like(g)
        for mine, rough in blocks:
            square = rough + np.diag(h[mine])
            both = np.linalg.solve(
                square, np.column_stack([coupling[mine], g[mine] - rough @ depth[mine]]))
            by_depth[mine], alone[mine] = both[:, :-1], both[:, -1]
        hessian = matrix - coupling.T @ by_depth
        right = vector - coupling.T @ alone
        damping = 1e-4 * np.diag(matrix) + 1e-6
        step = np.linalg.solve(hessian + np.diag(damping), right)
        step *= min(1.0, _STEP / max(1e-12, float(np.abs(step).max())))
        change = alone - by_depth @ step
        depth = np.clip(depth + np.clip(change, -0.1, 0.1), _FARTHEST, _NEAREST)
        angle = state.angle.copy()
        angle[1:] += step[:held].reshape(frames - 1, joints)
        state = replace(state, angle=angle, twist=displaced(state, basis, step[held:]))
    return Fit(state, depth, hessian)


def _roughness(rays: Rays) -> list[tuple[NDArray[np.intp], Array]]:
    """Of each key frame its points, and the matrix [n n] of what it costs where neighbours on one
    part have unlike depths."""
    out: list[tuple[NDArray[np.intp], Array]] = []
    for k in np.unique(rays.frame):
        mine = np.flatnonzero(rays.frame == k)
        rough = np.zeros((len(mine), len(mine)))
        if rays.near is not None:
            near = rays.near[mine][:, mine].toarray()
            near *= rays.label[mine, None] == rays.label[mine]
            near /= np.maximum(1.0, near.sum(axis=1, keepdims=True)) * _ROUGH**2
            near = (near + near.T) / 2
            rough = np.diag(near.sum(axis=1)) - near
        out.append((mine, rough))
    return out


def _assemble(
    state: Articulation, rays: Rays, intrinsics: Array, basis: tuple[Array, ...], scale: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Matrix [U U], vector [U], coupling with the depths [N U], and their h, g [N]."""
    frames, joints = state.angle.shape
    motion = state.motions(frames)
    derivative = state.derivatives(motion, basis)
    size = derivative.shape[2]
    keys = np.unique(rays.frame)
    key = np.searchsorted(keys, rays.frame)
    from_key = np.stack([motion @ inverse(motion[k]) for k in keys])
    a, b, c, h, g = accumulate(
        rays.ray, rays.inverse_depth, rays.label, key, from_key,
        float(intrinsics[0, 0]), intrinsics[:2, 2].astype(np.float64),
        rays.step, rays.step_information, rays.spot, rays.spot_information, scale,
    )  # fmt: skip
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    coupling = np.zeros((len(rays.ray), size))
    for k, frame in enumerate(keys):
        each = relative(derivative, from_key[k], derivative[frame : frame + 1]).swapaxes(2, 3)
        each[frame] = 0.0
        for p in range(1, joints + 1):
            pair = np.zeros((frames, 12, size))
            pair[:, :6] = each[:, p]
            pair[:-1, 6:] = each[1:, p]
            flat = pair.reshape(-1, size)
            matrix += flat.T @ (a[k, p] @ pair).reshape(-1, size)
            vector += flat.T @ b[k, p].reshape(-1)
            mine = (key == k) & (rays.label == p)
            coupling[mine] = c[mine].reshape(np.count_nonzero(mine), 12 * frames) @ flat
    return matrix, vector, coupling, h, g
