"""Starts of a video without depth: a beam search (see beam.py) judged by flow over a few frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import Beam, ChainSettings, Grid, Known, beamed, spread, thinned
from ..images import Footage
from ..numerics import Image, compiled
from .costs import FLOW_RATE, FLOW_SIGMA
from .labels import Spots

_TURN, _SLIDE = np.radians(6.5), 0.06  # largest step of a frame that is looked for, rad and m
_REACH = 2.0  # how much further it looks over longer spans
_PLACES = 14  # where in the image a hinge may be
_DEPTHS = (0.85, 1.15)  # and how far away, of the distance of what moves
_ROOT_DEPTHS = (0.8, 0.95, 1.1, 1.3, 1.6)  # that of the first one, which often is behind
_BEAM = 1200  # chains that are carried on to the next joint
_LIMIT = 9.0  # cost of a flow that is simply wrong
_SEEN_THROUGH = 1.5  # cost of a place where only background is seen, of that
_OUTSIDE = 0.5
_SPREAD = 0.3  # standard deviation of inverse depths about their mean
_LEAST = 1e-3  # of what flow is known by, where it is not


def swept_rays(seen: Footage, known: Known, points: Spots, to: int) -> Beam:
    """Chains over frames 0 and `to`, the best first; points are of frame 0."""
    places = spread(thinned(points.ray, 400), _PLACES)
    roots = places if known.base is None else known.base[None]
    reach = min(to, _REACH)
    grid = Grid(at_depths(roots, _ROOT_DEPTHS), at_depths(places, _DEPTHS), reach * _TURN,
                reach * _SLIDE, _BEAM)
    return beamed(known, by_flow(seen, points, to), grid, ChainSettings())


def at_depths(rays: Array, depths: tuple[float, ...]) -> Array:
    """[N*D 3] points on rays [N 3] at each of the depths."""
    return (rays[:, None] * np.array(depths)[:, None]).reshape(-1, 3)


def by_flow(seen: Footage, points: Spots, to: int) -> ByFlow:
    """Where flow takes points of frame 0 until frame `to`, and how surely."""
    height, width = seen.moving.shape[1:]
    at = points.pixel.astype(np.float64)
    spread_ = np.zeros((len(at), 2, 2))
    found = np.ones(len(at), bool)
    for t in range(to):
        u, v = np.rint(at).astype(np.int64).T
        found &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
        u, v = np.where(found, u, 0), np.where(found, v, 0)
        found &= seen.moving[t, v, u]
        step = seen.flow[t, v, u].astype(np.float64)
        hold = seen.hold[t, v, u][:, [0, 1, 1, 2]].reshape(-1, 2, 2) + _LEAST * np.eye(2)
        square = FLOW_SIGMA**2 + FLOW_RATE**2 * (step**2).sum(axis=1)
        spread_ += square[:, None, None] * np.linalg.inv(hold)
        at = at + step
    information: Array = np.asarray(np.linalg.inv(spread_), np.float64) * found[:, None, None]
    k = seen.intrinsics
    column = np.concatenate(
        [points.ray[:, :2], at, information.reshape(-1, 4)[:, [0, 1, 3]]], axis=1)
    return ByFlow(seen.moving[to], (float(k[0, 0]), float(k[0, 2]), float(k[1, 2])), column)


@dataclass(frozen=True)
class ByFlow:
    """Judges where points of frame 0 are in another (see beam.py)."""

    moving: NDArray[np.bool_]
    """[h w] there"""
    camera: tuple[float, float, float]
    """Focal length and principal point, px"""
    column: Array
    """[N 7] ray at depth 1 (2), place by flow (2) px, its information uu, uv, vv"""

    def costs(self, motion: Array) -> Image:
        out = np.empty((len(motion), len(self.column)), np.float32)
        judge_flow(self.moving, self.camera, motion, self.column, out)
        return out

    def means(self, motion: Array, turn: Array, before: Image) -> Image:
        out = np.empty((len(motion), len(turn)), np.float32)
        grow_flow(self.moving, self.camera, motion, turn, before, self.column, out)
        return out


@compiled
def flow_cost(
    moving: NDArray[np.bool_], camera: tuple[float, float, float], m: Array, column: Array, i: int
) -> float:
    focal, cu, cv = camera
    a, b = column[i, 0], column[i, 1]
    x = m[0, 0] * a + m[0, 1] * b + m[0, 2] + m[0, 3]
    y = m[1, 0] * a + m[1, 1] * b + m[1, 2] + m[1, 3]
    z = max(0.05, m[2, 0] * a + m[2, 1] * b + m[2, 2] + m[2, 3])
    u, v = focal * x / z + cu, focal * y / z + cv
    du = focal * (m[0, 3] - x / z * m[2, 3]) / z  # by inverse depth
    dv = focal * (m[1, 3] - y / z * m[2, 3]) / z
    ru, rv = column[i, 2] - u, column[i, 3] - v
    uu, uv, vv = column[i, 4], column[i, 5], column[i, 6]
    su, sv = uu * du + uv * dv, uv * du + vv * dv
    h = 1.0 / (_SPREAD * _SPREAD) + su * du + sv * dv
    q = min(1.0, max(-0.5, (su * ru + sv * rv) / h))
    u, v, ru, rv = u + q * du, v + q * dv, ru - q * du, rv - q * dv
    e = uu * ru * ru + 2 * uv * ru * rv + vv * rv * rv + q * q / (_SPREAD * _SPREAD)
    iu, iv = int(np.rint(u)), int(np.rint(v))
    if iu < 0 or iv < 0 or iu >= moving.shape[1] or iv >= moving.shape[0]:
        return _OUTSIDE * _LIMIT
    if not moving[iv, iu]:
        return _SEEN_THROUGH * _LIMIT
    return _LIMIT * e / (_LIMIT + e)


@compiled
def judge_flow(
    moving: NDArray[np.bool_], camera: tuple[float, float, float], motion: Array, column: Array,
    out: Image,
) -> None:
    for k in range(len(motion)):
        for i in range(len(column)):
            out[k, i] = flow_cost(moving, camera, motion[k], column, i)


@compiled
def grow_flow(
    moving: NDArray[np.bool_], camera: tuple[float, float, float], motion: Array, turn: Array,
    before: Image, column: Array, out: Image,
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
                total += min(flow_cost(moving, camera, both, column, i), before[k, i])
            out[k, p] = total / len(column)
