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

_ON_FOREGROUND = -1.0
_Numbers = tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]
"""Focal length and principal point, px; limit of the cost, information of inverse depths, and their
least and largest change"""


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
    ground = np.where(moving, _ON_FOREGROUND, s.background_cost * s.sweep_limit)
    ground = np.pad(ground.astype(np.float32), 1, constant_values=s.outside_cost * s.sweep_limit)
    f, cu, cv = np.array(camera, np.float32)
    numbers = (f, cu, cv, *np.array([
        s.sweep_limit, 1 / s.depth_sigma**2, s.min_sweep_inverse_depth - 1,
        s.max_sweep_inverse_depth - 1], np.float32))
    rows = np.ascontiguousarray(column.T, np.float32)

    def fill_costs(motion: Array, out: Image) -> None:
        _fill_costs(ground, motion, rows, numbers, out)

    def fill_means(motion: Array, turn: Array, before: Image, out: Image) -> None:
        _fill_means(ground, motion, turn, before, rows, numbers, out)

    return StepCosts(len(column), fill_costs, fill_means)


@compiled
def _cost(
    i: int, m: tuple[np.float32, ...], rows: Image, ground: NDArray[np.float32], height: int,
    width: int, numbers: _Numbers,
) -> np.float32:
    """Robust cost of point i (of rows [8 N]) under a motion, at its best depth after one iteration.

    Ground [h+2 w+2] has the cost of each place with a border that stands for all that is outside;
    it is negative where the cost is that of the flow. All is in single precision and without
    branches, so that a sum over points is compiled to instructions for several points.
    """
    m00, m01, m02, m03, m10, m11, m12, m13, m20, m21, m22, m23 = m
    focal, cu, cv, limit, stiff, low, high = numbers
    zero, two, near, middle = np.float32(0), np.float32(2), np.float32(0.05), np.float32(1.5)
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    a, b, expected = rows[0, i], rows[1, i], rows[7, i]
    x = m00 * a + m01 * b + m02 + expected * m03
    y = m10 * a + m11 * b + m12 + expected * m13
    z = m20 * a + m21 * b + m22 + expected * m23
    z = z if z > near else near
    x, y, scale = x / z, y / z, focal / z
    u, v = focal * x + cu, focal * y + cv
    du, dv = scale * (m03 - x * m23), scale * (m13 - y * m23)  # by inverse depth
    ru, rv = rows[2, i] - u, rows[3, i] - v
    uu, uv, vv = rows[4, i], rows[5, i], rows[6, i]
    su, sv = uu * du + uv * dv, uv * du + vv * dv
    q = (su * ru + sv * rv) / (stiff + su * du + sv * dv)
    q = q if q > low else low
    q = q if q < high else high
    u, v, ru, rv = u + q * du, v + q * dv, ru - q * du, rv - q * dv
    e = uu * ru * ru + two * uv * ru * rv + vv * rv * rv + stiff * q * q
    u, v = u + middle, v + middle  # the border is one pixel wide; half a pixel to round
    u = u if u > zero else zero
    u = u if u < right else right
    v = v if v > zero else zero
    v = v if v < bottom else bottom
    there = ground[np.uint32(np.int32(v) * np.int32(width) + np.int32(u))]
    return limit * e / (limit + e) if there < zero else there


@compiled
def _single(m: Array) -> tuple[np.float32, ...]:
    """The first three rows of a motion [4 4], in single precision."""
    return (np.float32(m[0, 0]), np.float32(m[0, 1]), np.float32(m[0, 2]), np.float32(m[0, 3]),
            np.float32(m[1, 0]), np.float32(m[1, 1]), np.float32(m[1, 2]), np.float32(m[1, 3]),
            np.float32(m[2, 0]), np.float32(m[2, 1]), np.float32(m[2, 2]), np.float32(m[2, 3]))


@compiled
def _fill_costs(
    ground: Image, motion: Array, rows: Image, numbers: _Numbers, out: Image
) -> None:
    places, (height, width) = ground.reshape(-1), ground.shape
    for k in range(len(motion)):
        m = _single(motion[k])
        for i in range(rows.shape[1]):
            out[k, i] = _cost(i, m, rows, places, height, width, numbers)


@compiled
def _fill_means(
    ground: Image, motion: Array, turn: Array, before: Image, rows: Image, numbers: _Numbers,
    out: Image,
) -> None:
    places, (height, width) = ground.reshape(-1), ground.shape
    both = np.empty((3, 4))
    for k in range(len(motion)):
        for p in range(len(turn)):
            for a in range(3):
                for b in range(4):
                    s = motion[k, a, 3] if b == 3 else 0.0
                    for c in range(3):
                        s += motion[k, a, c] * turn[p, c, b]
                    both[a, b] = s
            m, total = _single(both), np.float32(0)
            for i in range(rows.shape[1]):
                cost, old = _cost(i, m, rows, places, height, width, numbers), before[k, i]
                total += cost if cost < old else old
            out[k, p] = total / rows.shape[1]
