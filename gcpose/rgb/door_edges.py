"""Straight edges of a door, which show how its plane is tilted about its axis in each frame.

Most straight edges of a door are along its axis or across it: its sides, its handle, what is
printed on it. The image of an edge and the camera span a plane. An edge across the axis lies in
this plane, so that its direction follows from its image alone, whatever its depth is (the vanishing
point of the edge is known; Hartley and Zisserman, Multiple View Geometry, Sec. 8.6). The direction
turns with the door. Patches hardly show whether a door turns more or slopes more; these edges do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import geman_mcclure_cost
from .edge_planes import EdgePlanes
from .settings import RgbSettings

_ITERATIONS = 10
_TRIED_TILTS = np.arange(180) * np.pi / 180


@dataclass(frozen=True, eq=False)
class DoorEdges:
    """N straight edges in the images of a door, in the order of their frames."""

    frame: NDArray[np.int64]
    """[N]"""
    tilt: Array
    """[N] rad about the axis, modulo pi: the direction of an edge that is across the axis"""
    sigma: Array
    """[N] standard deviation of the tilt, rad"""

    def equations(
        self, turn: Array, scale: float, settings: RgbSettings
    ) -> tuple[Array, Array]:
        """Return the matrix [T-1 T-1] and the vector [T-1] of the turns of a door in frames 1..,
        at turns [T] since frame 0.

        The tilt in frame 0 is eliminated. The robust scale is in standard deviations. Edges of one
        frame have a common error as well, of `settings.edge_frame_sigma`.
        """
        frames = len(turn)
        above, at, sigma = self._tilts_above(turn, scale)
        weight = 1 / (sigma * (1 + (above / (scale * sigma)) ** 2)) ** 2
        total = np.bincount(at, weight, frames)
        mean = np.bincount(at, weight * above, frames) / np.maximum(total, 1e-12)
        information = settings.edge_weight * total / (1 + settings.edge_frame_sigma**2 * total)
        share = information / max(1e-12, float(information.sum()))
        matrix = np.diag(information) - np.outer(information, share)
        vector = information * (mean - share @ mean)
        return matrix[1:, 1:], vector[1:]

    def misfit(self, turn: Array, settings: RgbSettings) -> float:
        """Return the share of the edges that turns [T] of a door do not explain, a mean over the
        frames with edges: from 0 to 1, and 0 where there are none."""
        share, seen = self.missed_by_frame(turn, settings)
        return float(np.mean(share[seen > 0])) if seen.any() else 0.0

    def missed_by_frame(
        self, turn: Array, settings: RgbSettings
    ) -> tuple[Array, NDArray[np.int64]]:
        """Return the share of the edges of each frame [T] that turns [T] do not explain, and their
        number [T]."""
        above, at, sigma = self._tilts_above(turn, settings.edge_scale)
        missed = geman_mcclure_cost((above / (settings.edge_scale * sigma)) ** 2)
        total, share = (np.bincount(at, weight / sigma, len(turn)) for weight in (1.0, missed))
        return share / np.maximum(total, 1e-12), np.bincount(at, minlength=len(turn))

    def turns(self, frames: int, settings: RgbSettings) -> Array:
        """Return the turns [T] of a door by its edges alone, rad: those that explain most of them,
        to about a degree.

        Dynamic programming over the tilt and the step that led to it; a step is of at most
        `settings.max_edge_step`, and its change costs `settings.edge_jerk_cost`.
        """
        s, tried = settings, len(_TRIED_TILTS)
        near = np.zeros((frames, tried))
        wide = np.maximum(s.edge_scale * self.sigma, np.pi / tried)
        away = _wrap(self.tilt[:, None] - _TRIED_TILTS)
        explained = 1 / (1 + (away / wide[:, None]) ** 2) / self.sigma[:, None]
        np.add.at(near, self.frame, explained)
        near /= max(1e-12, float(near.max(axis=1).mean()))
        most = round(s.max_edge_step * tried / np.pi)
        step = np.arange(-most, most + 1)
        jerk = s.edge_jerk_cost * (step[:, None] - step) ** 2
        best = np.repeat(near[:1].T, len(step), axis=1)  # by the tilt and the step to it
        origin = np.zeros((frames, *best.shape), np.int64)
        for t in range(1, frames):
            through = best[:, None] - jerk  # [tilt before, step, step before]
            from_step, value = through.argmax(axis=2), through.max(axis=2)
            for k, by in enumerate(step):
                origin[t, :, k] = np.roll(from_step[:, k], by)
                best[:, k] = np.roll(value[:, k], by) + near[t]
        tilt, k = (int(i) for i in np.unravel_index(best.argmax(), best.shape))
        out = np.zeros(frames)
        for t in range(frames - 1, 0, -1):
            out[t - 1] = out[t] - step[k]
            tilt, k = (tilt - step[k]) % tried, origin[t, tilt, k]
        return (out - out[0]) * np.pi / tried

    def _tilts_above(
        self, turn: Array, scale: float
    ) -> tuple[Array, NDArray[np.int64], Array]:
        """Of the edges in the first T frames: their tilts above that of a door with turns [T],
        which fits most of them, their frames, and their standard deviations, [N] each."""
        count = int(np.searchsorted(self.frame, len(turn)))
        at, sigma = self.frame[:count], self.sigma[:count]
        tilt = self.tilt[:count] - turn[at]
        return _wrap(tilt - self.first_tilt(turn, scale)), at, sigma

    def first_tilt(self, turn: Array, scale: float) -> float:
        """Return the tilt in frame 0, modulo pi, that fits most of the edges in the first T frames
        of a door with turns [T]; 0 where there are none. The robust scale is in standard
        deviations."""
        count = int(np.searchsorted(self.frame, len(turn)))
        if not count:
            return 0.0
        sigma, tilt = self.sigma[:count], self.tilt[:count] - turn[self.frame[:count]]
        wide = scale * sigma
        missed = geman_mcclure_cost((_wrap(tilt - _TRIED_TILTS[:, None]) / wide) ** 2)
        first = _TRIED_TILTS[(missed / sigma).sum(axis=1).argmin()]
        for _ in range(_ITERATIONS):
            above = _wrap(tilt - first)
            first += np.average(above, weights=(sigma * (1 + (above / wide) ** 2)) ** -2)
        return float(first)


def see_edges(planes: EdgePlanes, axis: Array, settings: RgbSettings) -> DoorEdges | None:
    """Return the straight edges of a door that may be across its axis [3].

    None where few frames show any, or where no turns explain most of them, so that they are not
    across the axis.
    """
    edges = measure_tilts(planes, axis, settings)
    if len(np.unique(edges.frame)) < settings.min_edge_frames * planes.frames:
        return None
    lost = edges.misfit(edges.turns(planes.frames, settings), settings)
    return edges if lost <= settings.max_edge_misfit else None


def measure_tilts(planes: EdgePlanes, axis: Array, settings: RgbSettings) -> DoorEdges:
    """Return the edges in N planes, with the tilts that they have if they are across an axis [3].

    Edges along the axis, and others that show no tilt, are left out.
    """
    s, normal = settings, planes.normal
    one, other = across_axis(axis)
    tilt = np.arctan2(-normal @ one, normal @ other)
    square = np.full(len(tilt), s.edge_tilt_sigma**2)
    for change in planes.change.swapaxes(0, 1):
        turned = normal + change
        square += _wrap(np.arctan2(-turned @ one, turned @ other) - tilt) ** 2
    sigma = np.sqrt(square)
    shown = (np.abs(normal @ axis) > s.min_edge_sine) & (sigma < s.max_tilt_sigma)
    return DoorEdges(planes.frame[shown], tilt[shown], sigma[shown])


def across_axis(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors [3] across an axis [3] and each other; the tilt of the first is 0,
    and that of the second 90 degrees."""
    one = np.asarray(np.linalg.svd(axis[None])[2][1], np.float64)
    return one, np.asarray(np.cross(axis, one), np.float64)


def _wrap(tilt: Array) -> Array:
    return (tilt + np.pi / 2) % np.pi - np.pi / 2
