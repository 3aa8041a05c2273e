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

from ...robots.geometry import Array, pinhole
from ..images import VideoEvidence, moving_edges
from ..numerics import geman_mcclure_cost
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
        above, at, sigma = self._tilts_above(turn, settings.edge_scale)
        missed = geman_mcclure_cost((above / (settings.edge_scale * sigma)) ** 2)
        total, share = np.bincount(at, 1 / sigma), np.bincount(at, missed / sigma)
        seen = total > 0
        return float(np.mean(share[seen] / total[seen])) if seen.any() else 0.0

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
        if not count:
            return tilt, at, sigma
        wide = scale * sigma
        missed = geman_mcclure_cost((_wrap(tilt - _TRIED_TILTS[:, None]) / wide) ** 2)
        first = _TRIED_TILTS[(missed / sigma).sum(axis=1).argmin()]
        for _ in range(_ITERATIONS):
            above = _wrap(tilt - first)
            first += np.average(above, weights=(sigma * (1 + (above / wide) ** 2)) ** -2)
        return _wrap(tilt - first), at, sigma


def see_edges(video: VideoEvidence, axis: Array, settings: RgbSettings) -> DoorEdges | None:
    """Return the straight edges in the images of a door that may be across its axis [3].

    None where few frames show any, or where no turns explain most of them, so that they are not
    across the axis.
    """
    found = [measure_tilts(ends, video.intrinsics, axis, settings)
             for ends in moving_edges(video.gray, video.moving, video.settings)]
    if np.mean([len(tilt) > 0 for tilt, _ in found]) < settings.min_edge_frames:
        return None
    tilt, sigma = (np.concatenate(some) for some in zip(*found, strict=True))
    frame = np.repeat(np.arange(video.frames), [len(each) for each, _ in found])
    edges = DoorEdges(frame, tilt, sigma)
    lost = edges.misfit(edges.turns(video.frames, settings), settings)
    return edges if lost <= settings.max_edge_misfit else None


def measure_tilts(
    ends: Array, intrinsics: Array, axis: Array, settings: RgbSettings
) -> tuple[Array, Array]:
    """Return the tilts [N] of edges whose images have the ends [N 2 2], px, if they are across an
    axis [3], and the standard deviations of the tilts [N].

    Edges along the axis, and others that show no tilt, are left out.
    """
    s = settings
    one = np.linalg.svd(axis[None])[2][1]  # its tilt is 0
    other = np.cross(axis, one)
    ray = pinhole.pixel_rays(intrinsics, ends.reshape(-1, 2)).reshape(-1, 2, 3)
    across = (ends[:, 1] - ends[:, 0])[:, ::-1] * [-1, 1] / float(intrinsics[0, 0])
    across /= np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1, keepdims=True)
    moved = np.pad(across, ((0, 0), (0, 1)))  # an end that is 1 px away
    normal = np.cross(ray[:, 0], ray[:, 1])
    tilt = np.arctan2(-normal @ one, normal @ other)
    square = np.full(len(tilt), s.edge_tilt_sigma**2)
    for change in (np.cross(moved, ray[:, 1]), np.cross(ray[:, 0], moved)):
        turned = normal + s.edge_end_sigma * change
        square += _wrap(np.arctan2(-turned @ one, turned @ other) - tilt) ** 2
    sigma = np.sqrt(square)
    sine = np.abs(normal @ axis) / np.linalg.norm(normal, axis=1)
    shown = (sine > s.min_edge_sine) & (sigma < s.max_tilt_sigma)
    return tilt[shown], sigma[shown]


def _wrap(tilt: Array) -> Array:
    return (tilt + np.pi / 2) % np.pi - np.pi / 2
