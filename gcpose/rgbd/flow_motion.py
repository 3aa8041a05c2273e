"""Motion of the parts between two frames from optical flow and depth (Sec. 3.3).

The paper takes R and t of each part from its correspondences and then the angle about the axis.
Here all parts are solved jointly, in twists: part j moves with the sum of the z_i of its ancestors,
where joint i adds z_i. The knowledge of an axis confines z_i to a linear space: the multiples of
its screw if the line is known, the screws with its direction if that is known, else all twists.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, pinhole
from ..images import Candidates, Surfaces
from ..numerics import Solver, compiled, gauss_newton, truncated_cost
from .settings import StartSettings


@dataclass(frozen=True)
class Correspondence:
    """Matches of N points of frame 0 by flow and depth, linearized at no motion.

    The equations are row . twist = value, both in standard deviations.
    """

    row: Array
    """[N 3 6] point-to-plane distance, then flow u and v"""
    value: Array
    """[N 3]"""
    valid: NDArray[np.bool_]
    """[N 3]"""


def linearize_flow(
    surfaces: Surfaces, grid: Candidates, flow: Array, to: int, origin: Array,
    settings: StartSettings,
) -> Correspondence:
    """Linearize the flow [N 2] px from frame 0 to frame `to` at the candidates of frame 0.

    Twists are about `origin` [3], m.
    """
    points, pixel = grid.point, grid.pixel
    height, width = surfaces.depth.shape[1:]
    aim = np.rint(pixel + flow).astype(np.int64)
    inside = (aim >= 0).all(axis=1) & (aim[:, 0] < width) & (aim[:, 1] < height)
    aim = np.where(inside[:, None], aim, 0)
    z = surfaces.depth[to, aim[:, 1], aim[:, 0]].astype(np.float64)
    n = surfaces.normal[to, aim[:, 1], aim[:, 0]].astype(np.float64)
    target = pinhole.unproject(surfaces.intrinsics, aim, z)
    distance = np.linalg.norm(target - points, axis=1)
    reach = np.linalg.norm(flow, axis=1) * surfaces.footprint(points[:, 2])
    sigma = (settings.surface_sigma * surfaces.footprint(points[:, 2])
             + settings.surface_rate * reach + surfaces.noise)
    gate = settings.gate_rate * reach + settings.gate_sigma * sigma + settings.gate_distance
    hit = inside & (z > 0) & n.any(axis=1) & (distance < gate)
    f, g = surfaces.intrinsics[0, 0], surfaces.intrinsics[1, 1]
    x, y, depth = points.T
    zero = np.zeros_like(x)
    du = np.stack([f / depth, zero, -f * x / depth**2], axis=1)
    dv = np.stack([zero, g / depth, -g * y / depth**2], axis=1)
    flow_sigma = settings.flow_sigma + settings.flow_rate * np.linalg.norm(flow, axis=1)
    rows = [(n, sigma), (du, flow_sigma), (dv, flow_sigma)]
    arm = points - origin
    row = np.stack(
        [np.concatenate([np.cross(arm, d), d], axis=1) / s[:, None] for d, s in rows], axis=1
    )
    along = np.einsum("nc,nc->n", n, target - points) / sigma
    value = np.stack([along, flow[:, 0] / flow_sigma, flow[:, 1] / flow_sigma], axis=1)
    return Correspondence(row, value, np.stack([hit, inside, inside], axis=1))


@compiled
def add_weighted_rows(
    row: Array, value: Array, valid: NDArray[np.bool_], label: NDArray[np.int64], twist: Array,
    scale: float, matrix: Array, vector: Array,
) -> None:
    """Add each part's normal equations to matrix [J+1 6 6] and vector [J+1 6], with Geman-McClure's
    weights of the residuals under its twist [6]; the vector is for the whole twist."""
    for i in range(len(label)):
        j = label[i]
        if j == 0:
            continue
        for k in range(3):
            here, left = row[i, k], value[i, k]
            for a in range(6):
                left -= here[a] * twist[j, a]
            weight = valid[i, k] / (1 + (left / scale) ** 2) ** 2
            for a in range(6):
                vector[j, a] += weight * here[a] * value[i, k]
                for b in range(6):
                    matrix[j, a, b] += weight * here[a] * here[b]


def fit_twists(
    data: Correspondence, label: NDArray[np.int64], spaces: tuple[Array, ...], prior: Array,
    moves: NDArray[np.bool_], scales: tuple[float, ...],
) -> list[Array]:
    """Fit the twist z_i [6] of each joint by iteratively reweighted least squares.

    Args:
        data: Matches of N points.
        label: [N].
        spaces: [6 d_i] basis of each z_i.
        prior: [J 6 6] information of each z_i about zero.
        moves: [J+1 J] ancestors of each part.
        scales: Robust scale of each iteration, standard deviations.
    """
    size = [s.shape[1] for s in spaces]
    start = np.concatenate([[0], np.cumsum(size)])
    joined = np.concatenate(spaces, axis=1)
    held = np.zeros((start[-1], start[-1]))
    for i, s in enumerate(spaces):
        held[start[i] : start[i + 1], start[i] : start[i + 1]] = s.T @ prior[i] @ s

    def linearize(y: Array, scale: float) -> tuple[Array, Array]:
        six, right = np.zeros((len(moves), 6, 6)), np.zeros((len(moves), 6))
        z = np.stack([s @ y[start[i] : start[i + 1]] for i, s in enumerate(spaces)])
        add_weighted_rows(data.row, data.value, data.valid, label, moves @ z, scale, six, right)
        matrix, vector = held.copy(), np.zeros(start[-1])
        for j in range(1, len(moves)):
            some = np.flatnonzero(np.repeat(moves[j], size))
            basis = joined[:, some]
            matrix[np.ix_(some, some)] += basis.T @ six[j] @ basis
            vector[some] += basis.T @ right[j]
        return matrix, vector - matrix @ y

    y = gauss_newton(np.zeros(start[-1]), linearize, np.add, scales, Solver())
    return [s @ y[start[i] : start[i + 1]] for i, s in enumerate(spaces)]


def match_costs(
    data: Correspondence, added: list[Array], moves: NDArray[np.bool_], settings: StartSettings
) -> Array:
    """Return the truncated cost [N J+1] of each part's motion for each point, variances."""
    twist = moves @ np.stack(added)
    residual = data.value[:, None] - np.einsum("nrc,jc->njr", data.row, twist)
    square = residual**2
    plane = truncated_cost(square[..., 0], settings.max_surface_cost)
    plane = np.where(data.valid[:, None, 0], plane, settings.missing_surface_cost)
    flow = truncated_cost(square[..., 1] + square[..., 2], settings.max_flow_cost)
    flow = np.where(data.valid[:, None, 1], flow, settings.missing_flow_cost)
    return plane + settings.flow_weight * flow
