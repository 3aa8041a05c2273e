"""The direction of a door's axis, by its straight edges alone.

Most straight edges of a door are along its axis or across it. Those along it have the same
direction in all frames, and those across it turn with the door. So the direction of the axis is the
one that explains most edges, with a direction across it for each frame: an edge lies in the plane
that its image and the camera span. Edges along the axis show it as their vanishing point does
(Hartley and Zisserman, Multiple View Geometry, Sec. 8.6).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import compiled
from .door_edges import across_axis, measure_tilts
from .edge_planes import EdgePlanes, distinct_directions
from .settings import RgbSettings

_TRIED_DIRECTIONS = 1500  # on the half sphere, about 4 degrees from one to the next
_TRIED_TILTS = 60  # of the edges across each of them, in each frame
_WEAK_PRIOR = 1e-3  # information about the tilt of a frame without edges, 1/rad^2


@dataclass(frozen=True, eq=False)
class DoorAxis:
    """The axis of a door by its edges in T frames."""

    direction: Array
    """[3] unit vector"""
    across: Array
    """[T 3] unit vectors: the directions of the edges across it in each frame"""
    covariance: Array
    """[2+T 2+T] of the direction, about two directions across it, and of the tilts, rad^2"""
    explained: float = 0.0
    """Share of the edges that are along it or across it, by length; a mean over the frames"""

    @property
    def deviation(self) -> float:
        """The standard deviation of the direction, rad."""
        return float(np.sqrt(np.trace(self.covariance[:2, :2])))

    def turn_deviation(self) -> Array:
        """Return the standard deviations [T] of the turns since frame 0, rad: that part of them
        that comes from the direction of the axis."""
        by_axis = self.covariance[2:, :2] - self.covariance[2, :2]
        square = (by_axis @ np.linalg.inv(self.covariance[:2, :2]) * by_axis).sum(axis=1)
        return np.sqrt(np.maximum(0.0, square))


def find_axis(
    planes: EdgePlanes, still: EdgePlanes, settings: RgbSettings
) -> DoorAxis | None:
    """Return the axis of a door; None where its edges, and those that stand still, do not tell
    it."""
    s = settings
    if len(np.unique(planes.frame)) < max(2.0, s.min_edge_frames * planes.frames):
        return None
    found = [refine_axis(planes, still, direction, s) for direction in propose_axes(planes, s)]
    best = max(found, key=lambda axis: axis.explained)
    second = max((axis.explained for axis in found if abs(axis.direction @ best.direction)
                  < np.cos(s.distinct_axis)), default=0.0)
    told = (best.explained >= s.min_axis_share and best.explained - second >= s.min_axis_lead
            and best.deviation <= s.max_axis_sigma)
    return best if told else None


def propose_axes(planes: EdgePlanes, settings: RgbSettings) -> list[Array]:
    """Return directions [3] that may be near that of the axis: those along which most edges are,
    and those that explain most if each frame has the direction across it that suits it."""
    s, share = settings, planes.share
    first = planes.common_directions(s)
    tried = np.concatenate([first, _half_sphere(_TRIED_DIRECTIONS)])
    bases = np.stack([np.stack([axis, *across_axis(axis)]) for axis in tried])
    explained = _explained_shares(
        bases, planes.frame, planes.normal, planes.change, share, s.edge_scale,
        s.edge_tilt_sigma, s.max_tilt_sigma)
    return [*first, *distinct_directions(tried, explained, s)]


def refine_axis(
    planes: EdgePlanes, still: EdgePlanes, direction: Array, settings: RgbSettings
) -> DoorAxis:
    """Return the axis near a direction [3] that fits best: robust Gauss-Newton, from directions
    across it that turn steadily."""
    s = settings
    axis = DoorAxis(direction, np.zeros((planes.frames, 3)), np.eye(2 + planes.frames))
    for k in range(s.axis_rounds):
        if k in (0, s.axis_rounds // 2):
            axis = replace(axis, across=_turn_across(planes, axis.direction, s))
        axis = _step(planes, still, axis, s)
    along, across = (planes.fit(v, s)[2] for v in (axis.direction, axis.across[planes.frame]))
    if np.abs(axis.across @ axis.across[0]).min() > np.cos(s.min_edge_turn):
        across *= 0  # the edges along an axis are across many others that do not turn
    share = float(np.maximum(along, across) @ planes.share)
    return replace(axis, explained=share)


def _turn_across(planes: EdgePlanes, direction: Array, settings: RgbSettings) -> Array:
    """Directions [T 3] across an axis [3] that turn steadily and explain most of the edges that are
    not along it."""
    s, (one, other) = settings, across_axis(direction)
    along = planes.fit(direction, s)[2]
    edges = measure_tilts(planes.some(along < 0.5), direction, s)
    turn = edges.turns(planes.frames, s)
    tilt = turn + edges.first_tilt(turn, s.edge_scale)
    return np.cos(tilt)[:, None] * one + np.sin(tilt)[:, None] * other


def _step(
    planes: EdgePlanes, still: EdgePlanes, axis: DoorAxis, settings: RgbSettings
) -> DoorAxis:
    """The axis and the directions across it after an iteration. An edge counts as along the axis or
    as across it, where it fits better."""
    s, (one, other) = settings, across_axis(axis.direction)
    mine = axis.across[planes.frame]
    (off, sigma, along), (missed, sigma_across, across) = (
        planes.fit(v, s) for v in (axis.direction, mine))
    is_along = along >= across
    gradient = np.zeros((len(off), 2 + planes.frames))
    for i, to in enumerate((one, other)):  # what is across the axis stays across it
        gradient[:, i] = np.where(is_along, planes.normal @ to, -off * (mine @ to))
    at = np.flatnonzero(~is_along)
    ahead = np.cross(axis.direction, axis.across)
    gradient[at, 2 + planes.frame[at]] = (planes.normal * ahead[planes.frame]).sum(axis=1)[at]
    weight = np.maximum(along, across) / np.where(is_along, sigma, sigma_across)
    gradient *= weight[:, None]
    matrix = gradient.T @ gradient + _WEAK_PRIOR * np.eye(2 + planes.frames)
    vector = gradient.T @ (weight * np.where(is_along, off, missed))
    off, sigma, along = still.fit(axis.direction, s)
    gradient = still.normal @ np.stack([one, other], axis=1) * (along / sigma)[:, None]
    matrix[:2, :2] += gradient.T @ gradient
    vector[:2] += gradient.T @ (off * along / sigma)
    step = -np.linalg.solve(matrix, vector)
    step = np.clip(step, -s.max_axis_step, s.max_axis_step)
    direction = _unit(axis.direction + step[0] * one + step[1] * other)
    turned = axis.across + step[2:, None] * ahead
    turned = _unit(turned - np.outer(turned @ direction, direction))
    return DoorAxis(direction, turned, np.linalg.inv(matrix))


def _half_sphere(count: int) -> Array:
    """Directions [count 3], evenly spread (Fibonacci lattice)."""
    z = (np.arange(count) + 0.5) / count
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), np.float64)


@compiled
def _explained_shares(
    bases: Array, frame: NDArray[np.int64], normal: Array, change: Array, share: Array,
    scale: float, least: float, most: float,
) -> Array:
    """Share [M] of the edges that each axis explains; bases [M 3 3] hold it and two directions
    across it. In one loop, what `EdgePlanes.fit` and `measure_tilts` compute of one axis."""
    out, per_tilt = np.zeros(len(bases)), np.pi / _TRIED_TILTS
    wide = scale * per_tilt / 2
    for m in range(len(bases)):
        total = np.zeros(_TRIED_TILTS)
        for i in range(len(frame)):
            a, u, v = bases[m, 0] @ normal[i], bases[m, 1] @ normal[i], bases[m, 2] @ normal[i]
            square, tilt_square, flat = least * least, 0.0, max(1e-12, u * u + v * v)
            for k in range(2):
                da = bases[m, 0] @ change[i, k]
                du, dv = bases[m, 1] @ change[i, k], bases[m, 2] @ change[i, k]
                square += da * da
                tilt_square += ((u * dv - v * du) / flat) ** 2
            along = 1 / (1 + a * a / (square * scale * scale))
            out[m] += along * share[i]
            rest = (1 - along) * share[i]
            if tilt_square < most * most:
                tilt = np.arctan2(-u, v) / per_tilt
                width = max(wide, scale * np.sqrt(tilt_square)) / per_tilt
                for k in range(_TRIED_TILTS):
                    away = (tilt - k + _TRIED_TILTS / 2) % _TRIED_TILTS - _TRIED_TILTS / 2
                    total[k] += rest / (1 + (away / width) ** 2)
            if i + 1 == len(frame) or frame[i + 1] != frame[i]:
                out[m] += total.max()
                total[:] = 0.0
    return out
