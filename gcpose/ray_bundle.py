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

from ..robots.geometry import Array, inverse
from .articulation import Articulation, displaced
from .chain import axis_basis, relative
from .compiled import compiled
from .prior import Hinges, closeness, smoothness
from .ray_points import Rays


@compiled
def accumulate(
    ray: Array, inverse_depth: Array, label: NDArray[np.int64], key: NDArray[np.int64],
    relative: Array, focal: float, centre: Array, step_obs: Array, step_info: Array,
    spot_obs: Array, spot_info: Array, scale: float,
) -> tuple[Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """Normal equations of N points over T frames.

    ray [N 3] (z = 1), key [N] index into `relative` [K T P 4 4] (frame from key frame).
    step_obs [N T-1 2] px flow at the point's place in frame t, step_info [N T-1 2 2];
    spot_obs [N T 2] px place in frame t, spot_info [N T 2 2].
    Returns matrix [K P T 12 12] (twists of t and t + 1), b [K P T 12], c [N T 12] (twists by
    depth), h [N], g [N], cost [N].
    """
    n, frames = len(ray), relative.shape[1]
    keys, parts = relative.shape[0], relative.shape[2]
    matrix = np.zeros((keys, parts, frames, 12, 12))
    b = np.zeros((keys, parts, frames, 12))
    c = np.zeros((n, frames, 12))
    h = np.zeros(n)
    g = np.zeros(n)
    cost = np.zeros(n)
    slope = np.zeros((frames, 2, 6))
    by_depth = np.zeros((frames, 2))
    at = np.zeros((frames, 2))
    bad = np.zeros(frames)
    row = np.zeros((2, 12))
    for i in range(n):
        k, p = key[i], label[i]
        q = inverse_depth[i]
        for t in range(frames):
            motion = relative[k, t, p]
            # scaled point: (R ray + q T), depth of 1/q
            x0 = motion[0, 0] * ray[i, 0] + motion[0, 1] * ray[i, 1] + motion[0, 2] * ray[i, 2]
            y0 = motion[1, 0] * ray[i, 0] + motion[1, 1] * ray[i, 1] + motion[1, 2] * ray[i, 2]
            z0 = motion[2, 0] * ray[i, 0] + motion[2, 1] * ray[i, 1] + motion[2, 2] * ray[i, 2]
            x, y, z = x0 + q * motion[0, 3], y0 + q * motion[1, 3], z0 + q * motion[2, 3]
            bad[t] = 1.0 if z < 0.05 else 0.0
            z = max(z, 0.05)
            u, v = x / z, y / z
            at[t, 0], at[t, 1] = focal * u + centre[0], focal * v + centre[1]
            by_depth[t, 0] = focal * (motion[0, 3] - u * motion[2, 3]) / z
            by_depth[t, 1] = focal * (motion[1, 3] - v * motion[2, 3]) / z
            # twist on the point (x, y, z) / q
            qz = q / z
            slope[t, 0, 0], slope[t, 0, 1] = -focal * u * v, focal * (1 + u * u)
            slope[t, 0, 2] = -focal * v
            slope[t, 1, 0], slope[t, 1, 1] = -focal * (1 + v * v), focal * u * v
            slope[t, 1, 2] = focal * u
            slope[t, 0, 3], slope[t, 0, 4], slope[t, 0, 5] = focal * qz, 0.0, -focal * u * qz
            slope[t, 1, 3], slope[t, 1, 4], slope[t, 1, 5] = 0.0, focal * qz, -focal * v * qz
        for kind in range(2):
            for t in range(frames - 1 if kind == 0 else frames):
                if kind == 0:
                    w00, w01 = step_info[i, t, 0, 0], step_info[i, t, 0, 1]
                    w11 = step_info[i, t, 1, 1]
                    if w00 + w11 <= 0 or bad[t] + bad[t + 1] > 0:
                        continue
                    r0 = step_obs[i, t, 0] - (at[t + 1, 0] - at[t, 0])
                    r1 = step_obs[i, t, 1] - (at[t + 1, 1] - at[t, 1])
                    d0 = by_depth[t + 1, 0] - by_depth[t, 0]
                    d1 = by_depth[t + 1, 1] - by_depth[t, 1]
                else:
                    w00, w01 = spot_info[i, t, 0, 0], spot_info[i, t, 0, 1]
                    w11 = spot_info[i, t, 1, 1]
                    if w00 + w11 <= 0 or bad[t] > 0:
                        continue
                    r0 = spot_obs[i, t, 0] - at[t, 0]
                    r1 = spot_obs[i, t, 1] - at[t, 1]
                    d0, d1 = by_depth[t, 0], by_depth[t, 1]
                e = (w00 * r0 * r0 + 2 * w01 * r0 * r1 + w11 * r1 * r1) / (scale * scale)
                robust = 1.0 / ((1.0 + e) * (1.0 + e))
                cost[i] += scale * scale * e / (1.0 + e)
                w00, w01, w11 = w00 * robust, w01 * robust, w11 * robust
                a0, a1 = w00 * r0 + w01 * r1, w01 * r0 + w11 * r1
                h[i] += w00 * d0 * d0 + 2 * w01 * d0 * d1 + w11 * d1 * d1
                g[i] += a0 * d0 + a1 * d1
                size = 12 if kind == 0 else 6
                for m in range(6):
                    if kind == 0:
                        row[0, m], row[1, m] = -slope[t, 0, m], -slope[t, 1, m]
                        row[0, 6 + m], row[1, 6 + m] = slope[t + 1, 0, m], slope[t + 1, 1, m]
                    else:
                        row[0, m], row[1, m] = slope[t, 0, m], slope[t, 1, m]
                for m in range(size):
                    s0 = w00 * row[0, m] + w01 * row[1, m]
                    s1 = w01 * row[0, m] + w11 * row[1, m]
                    b[k, p, t, m] += a0 * row[0, m] + a1 * row[1, m]
                    c[i, t, m] += s0 * d0 + s1 * d1
                    for l in range(m + 1):
                        matrix[k, p, t, m, l] += s0 * row[0, l] + s1 * row[1, l]
    for k in range(keys):
        for p in range(parts):
            for t in range(frames):
                for m in range(12):
                    for l in range(m):
                        matrix[k, p, t, l, m] = matrix[k, p, t, m, l]
    return matrix, b, c, h, g, cost


_STEP = 0.15  # largest change of an unknown in an iteration, rad or m
_NEAREST, _FARTHEST = 2.5, 0.4  # of inverse depths
_ROUGH = 0.1  # standard deviation of a point's inverse depth from those of its neighbours


@dataclass(frozen=True)
class Fit:
    """What an adjustment leaves."""

    state: Articulation
    inverse_depth: Array
    """[N]"""
    cost: Array
    """[N] robust sum of squares of each point"""
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
    cost, hessian = np.zeros(len(depth)), np.zeros((0, 0))
    blocks = _roughness(rays)
    for scale in scales:
        basis = tuple(
            axis_basis(state.twist[j], bool(state.prismatic[j]), hinges.point[j], freedom)
            for j in range(joints)
        )
        matrix, vector, coupling, h, g, cost = _assemble(
            state, replace(rays, inverse_depth=depth), intrinsics, basis, scale
        )
        prior = smoothness(state.angle, frames - 1)
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
    return Fit(state, depth, cost, hessian)


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
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Matrix [U U], vector [U], coupling with the depths [N U], their h, g [N] and costs [N]."""
    frames, joints = state.angle.shape
    motion = state.motions(frames)
    derivative = state.derivatives(motion, basis)
    size = derivative.shape[2]
    keys = np.unique(rays.frame)
    key = np.searchsorted(keys, rays.frame)
    from_key = np.stack([motion @ inverse(motion[k]) for k in keys])
    a, b, c, h, g, cost = accumulate(
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
    return matrix, vector, coupling, h, g, cost
