"""Starts from optical flow and depth (Sec. 3.3): many initial labels, and EM between two frames.

The paper takes R and t of each part from its correspondences and then the angle about the axis.
Here all parts are solved jointly, in twists: part j moves with the sum of the z_i of its ancestors,
where joint i adds z_i. The knowledge of an axis confines z_i to a linear space: the multiples of
its screw if the line is known, the screws with its direction if that is known, else all twists.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, pinhole, se3
from ..chain import (
    Articulation,
    ancestors,
    axis_from_twist,
    extent,
    locate_hinges,
    twist_about,
    twist_spaces,
)
from ..estimator import Hypothesis
from ..images import Flow, smooth_costs
from ..numerics import Image, Solver, compiled, gauss_newton, thread_map, truncated_cost
from .evidence import DepthHypothesis, RgbdEvidence
from .labels import Cloud, Clouds
from .settings import StartSettings
from .strategies import Strategy


def start_from_flow(
    evidence: RgbdEvidence, flow: Flow, strategy: Strategy
) -> list[DepthHypothesis]:
    """Return the best starts of a strategy by flow from frame 0 over each of its spans."""
    priors, settings = evidence.priors, evidence.settings
    labels = initial_labels(evidence.ranks[0], evidence.moving, len(priors.prismatic),
                            settings.start.cuts)
    slacks = settings.start.hinge_slacks if priors.axis_dof else settings.start.hinge_slacks[:1]
    found: list[DepthHypothesis] = []
    for span in strategy.flow_spans:
        to = min(span, evidence.surfaces.frames - 1)
        data = linearize_flow(evidence, flow(evidence.rgb[0], evidence.rgb[to]), to)
        for slack in slacks:
            some = thread_map(partial(solve_start, evidence, data, slack), labels)
            found += evidence.select(some, strategy.flow_kept)
    return found


def initial_labels(
    rank: Array, moving: NDArray[np.bool_], joints: int, cuts: tuple[float, ...]
) -> list[NDArray[np.int64]]:
    """Return labels [N] that cut the moving points by geodesic rank [N] into J parts, for every
    choice of cuts."""
    return [
        np.where(moving, 1 + np.searchsorted(np.array(some), rank), 0)
        for some in combinations(cuts, joints - 1)
    ]


def solve_start(
    evidence: RgbdEvidence, data: Correspondence, slack: float, label: NDArray[np.int64]
) -> DepthHypothesis:
    """Run EM between two frames from initial labels [N]; displacements are interpolated.

    `slack` is the standard deviation of a hinge's displacement, by the object's extent.
    """
    grid, priors, origin = evidence.grid(0), evidence.priors, data.origin
    tuned, chain = evidence.settings.start, evidence.settings.chain
    joints = len(priors.prismatic)
    spaces = tuple(twist_about(origin, s.T).T for s in twist_spaces(priors))
    moves = ancestors(priors.parent)
    inside = grid.point[label > 0]
    sigma = slack * (extent(inside, chain) if len(inside) else 1.0)
    added, cost, hinge = [np.zeros(6)] * joints, np.inf, np.zeros((joints, 3))
    for _ in range(tuned.rounds):
        hinge = locate_hinges(grid.point, label, evidence.base_candidates[0], priors.parent, chain)
        prior = np.stack([joint_information(p - origin, sigma, tuned.turn_sigma) for p in hinge])
        added = fit_twists(data, label, spaces, prior, moves, tuned.robust_scales)
        volume = smooth_costs(match_costs(data, added, moves, tuned), grid)
        label = volume.argmin(axis=1)
        cost = float(volume.min(axis=1).mean())
    twist, angle = np.zeros((joints, 6)), np.zeros((data.to + 1, joints))
    for j in range(joints):
        twist[j], end = axis_from_twist(twist_about(-origin, added[j]), priors, j, hinge[j],
                                        tuned.min_turn, chain.max_axis_offset)
        angle[:, j] = np.linspace(0, end, data.to + 1)
    cloud = Cloud(0, grid.point, grid.normal, label)
    state = Articulation(twist, angle, priors.prismatic, priors.parent)
    return Hypothesis(state, Clouds([cloud]), evidence.base_candidates[0], cost)


def joint_information(hinge: Array, slip: float, turn: float) -> Array:
    """Return the information [6 6] of a twist (w, v) that moves its hinge [3] by `slip` and turns
    by `turn` (standard deviations, m and rad)."""
    velocity = np.concatenate([-se3.hat(hinge), np.eye(3)], axis=1)  # of the hinge
    out = velocity.T @ velocity / slip**2
    out[:3, :3] += np.eye(3) / turn**2
    return out


@dataclass(frozen=True)
class Correspondence:
    """Matches of N points of frame 0 in frame `to` by flow and depth, linearized at no motion.

    The equations are row . twist = value, both in standard deviations.
    """

    to: int
    origin: Array
    """[3] about which twists are, m"""
    row: Array
    """[N 3 6] point-to-plane distance, then flow u and v"""
    value: Array
    """[N 3]"""
    valid: NDArray[np.bool_]
    """[N 3]"""


def linearize_flow(evidence: RgbdEvidence, field: Image, to: int) -> Correspondence:
    """Linearize the flow [H W 2] px from frame 0 to frame `to` at the candidates of frame 0."""
    surfaces, settings, grid = evidence.surfaces, evidence.settings.start, evidence.grid(0)
    points, pixel = grid.point, grid.pixel
    origin = points[evidence.moving].mean(axis=0)
    flow = field[pixel[:, 1], pixel[:, 0]].astype(np.float64)
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
    return Correspondence(to, origin, row, value, np.stack([hit, inside, inside], axis=1))


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

    Each z_i has a basis [6 d_i] and the information [6 6] about zero; moves are the ancestors
    [J+1 J] of the parts.
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
