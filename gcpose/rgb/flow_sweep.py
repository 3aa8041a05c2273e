"""Initial steps without depth: a beam search along the chain, scored by flow over a few frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import Beam, JointPriors, StepCosts, StepGrid, beam_search, spread_places
from ..images import VideoEvidence
from ..numerics import Image, compiled
from .labels import SampledPixels
from .settings import RgbSettings


def sweep_flow(
    evidence: VideoEvidence, known: JointPriors, points: SampledPixels, to: int,
    settings: RgbSettings,
) -> Beam:
    """Return chains over frames 0 and `to`, the best first; points are of frame 0."""
    s = settings
    places = spread_places(points.ray / points.expected[:, None], s.hinge_places, s.spread_points)
    roots = places if known.base is None else known.base[None]
    frames = min(to, s.max_step_frames)
    grid = StepGrid(
        places_at_depths(roots, s.root_depths), places_at_depths(places, s.hinge_depths),
        frames * s.max_turn, frames * s.max_slide, s.beam_width)
    return beam_search(known, accumulate_flow(evidence, points, to, s), grid, s.chain)


def places_at_depths(rays: Array, depths: tuple[float, ...]) -> Array:
    """Return the points [N*D 3] on rays [N 3] at each of the depths."""
    return (rays[:, None] * np.array(depths)[:, None]).reshape(-1, 3)


def accumulate_flow(
    evidence: VideoEvidence, points: SampledPixels, to: int, settings: RgbSettings
) -> StepCosts:
    """Follow points of frame 0 along the flow to frame `to`, and sum its covariances."""
    height, width = evidence.moving.shape[1:]
    at = points.pixel.astype(np.float64)
    covariance = np.zeros((len(at), 2, 2))
    found = np.ones(len(at), bool)
    for t in range(to):
        u, v = np.rint(at).astype(np.int64).T
        found &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
        u, v = np.where(found, u, 0), np.where(found, v, 0)
        found &= evidence.moving[t, v, u]
        flow = evidence.flow[t, v, u].astype(np.float64)
        confidence = evidence.flow_confidence[t, v, u][:, [0, 1, 1, 2]].reshape(-1, 2, 2)
        confidence = confidence + settings.min_texture * np.eye(2)
        variance = settings.flow_sigma**2 + settings.flow_rate**2 * (flow**2).sum(axis=1)
        covariance += variance[:, None, None] * np.linalg.inv(confidence)
        at = at + flow
    information: Array = np.asarray(np.linalg.inv(covariance), np.float64) * found[:, None, None]
    k = evidence.intrinsics
    column = np.concatenate(
        [points.ray[:, :2], at, information.reshape(-1, 4)[:, [0, 1, 3]],
         points.expected[:, None]], axis=1)
    camera = (float(k[0, 0]), float(k[0, 2]), float(k[1, 2]))
    return flow_step_costs(evidence.moving[to], camera, column, settings)


def flow_step_costs(
    moving: NDArray[np.bool_], camera: tuple[float, float, float], column: Array,
    settings: RgbSettings,
) -> StepCosts:
    """Return the costs of points of frame 0 in another frame with a foreground [h w].

    Columns [N 8] are the ray at depth 1 (2), the place by flow (2), px, its information uu, uv, vv,
    and the expected inverse depth; the camera is the focal length and the principal point, px.
    """
    s = settings
    numbers = (s.sweep_limit, s.outside_cost, s.background_cost, s.depth_sigma,
               s.min_sweep_inverse_depth - 1.0, s.max_sweep_inverse_depth - 1.0)

    def fill_costs(motion: Array, out: Image) -> None:
        _fill_costs(moving, camera, motion, column, numbers, out)

    def fill_means(motion: Array, turn: Array, before: Image, out: Image) -> None:
        _fill_means(moving, camera, motion, turn, before, column, numbers, out)

    return StepCosts(len(column), fill_costs, fill_means)


@compiled
def _cost(
    moving: NDArray[np.bool_], camera: tuple[float, float, float], m: Array, column: Array, i: int,
    numbers: tuple[float, float, float, float, float, float],
) -> float:
    """Robust cost of point i under a motion [4 4], at its best depth after one iteration."""
    focal, cu, cv = camera
    limit, outside, background, sigma, low, high = numbers
    a, b, expected = column[i, 0], column[i, 1], column[i, 7]
    x = m[0, 0] * a + m[0, 1] * b + m[0, 2] + expected * m[0, 3]
    y = m[1, 0] * a + m[1, 1] * b + m[1, 2] + expected * m[1, 3]
    z = max(0.05, m[2, 0] * a + m[2, 1] * b + m[2, 2] + expected * m[2, 3])
    u, v = focal * x / z + cu, focal * y / z + cv
    du = focal * (m[0, 3] - x / z * m[2, 3]) / z  # by inverse depth
    dv = focal * (m[1, 3] - y / z * m[2, 3]) / z
    ru, rv = column[i, 2] - u, column[i, 3] - v
    uu, uv, vv = column[i, 4], column[i, 5], column[i, 6]
    su, sv = uu * du + uv * dv, uv * du + vv * dv
    h = 1.0 / (sigma * sigma) + su * du + sv * dv
    q = min(high, max(low, (su * ru + sv * rv) / h))
    u, v, ru, rv = u + q * du, v + q * dv, ru - q * du, rv - q * dv
    e = uu * ru * ru + 2 * uv * ru * rv + vv * rv * rv + q * q / (sigma * sigma)
    iu, iv = int(np.rint(u)), int(np.rint(v))
    if iu < 0 or iv < 0 or iu >= moving.shape[1] or iv >= moving.shape[0]:
        return outside * limit
    if not moving[iv, iu]:
        return background * limit
    return limit * e / (limit + e)


@compiled
def _fill_costs(
    moving: NDArray[np.bool_], camera: tuple[float, float, float], motion: Array, column: Array,
    numbers: tuple[float, float, float, float, float, float], out: Image,
) -> None:
    for k in range(len(motion)):
        for i in range(len(column)):
            out[k, i] = _cost(moving, camera, motion[k], column, i, numbers)


@compiled
def _fill_means(
    moving: NDArray[np.bool_], camera: tuple[float, float, float], motion: Array, turn: Array,
    before: Image, column: Array, numbers: tuple[float, float, float, float, float, float],
    out: Image,
) -> None:
    both = np.empty((4, 4))
    for k in range(len(motion)):
        for p in range(len(turn)):
            for a in range(3):
                for b in range(4):
                    s = motion[k, a, 3] if b == 3 else 0.0
                    for c in range(3):
                        s += motion[k, a, c] * turn[p, c, b]
                    both[a, b] = s
            total = 0.0
            for i in range(len(column)):
                total += min(_cost(moving, camera, both, column, i, numbers), before[k, i])
            out[k, p] = total / len(column)
