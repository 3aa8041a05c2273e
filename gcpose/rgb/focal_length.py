"""The focal length of a camera that sees a door turn, by the straight edges of the door.

Edges along the axis are at right angles to those across it. Seen with a wrong focal length, they
are not, and differ from it in other ways as the door turns (compare camera calibration by vanishing
points of directions at right angles: Caprile and Torre, Using vanishing points for camera
calibration, 1990). So the right one explains most edges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...robots.geometry import Array
from ..images import VideoEvidence, moving_edges, still_edges
from .door_axis import DoorAxis, find_axis, propose_axes, refine_axis
from .door_edges import EdgePlanes
from .settings import RgbSettings

_TRIED = np.exp(np.arange(-0.8, 1.3, 0.2))  # by that of the video; 50 deg become 92 to 16 deg
_FINER = (0.04, 0.01)  # steps of the logarithm
_STEPS = np.arange(-5, 6)


def find_focal_length(video: VideoEvidence, settings: RgbSettings) -> float | None:
    """Return the focal length of a video, px; None where the edges of a door do not tell it.

    The principal point is that of the video; its focal length is where the search begins.
    """
    s, edges = settings, _Edges.of_video(video, settings)
    if not any(map(len, edges.moving)):
        return None
    found = [edges.fit(focal) for focal in float(video.intrinsics[0, 0]) * _TRIED]
    found = sorted(found, key=_share_of)[-s.focals_kept :]
    for step in _FINER:
        found = [max(edges.fit_near(fit, np.exp(step * _STEPS)), key=_share_of) for fit in found]
    best = max(found, key=_share_of)
    others = edges.fit_near(best, np.exp([-s.focal_apart, s.focal_apart]))
    told = _share_of(best) - max(map(_share_of, others)) >= s.min_focal_lead
    return best.focal if told and find_axis(*edges.planes(best.focal), s) else None


@dataclass(frozen=True)
class _Fit:
    """The axis that explains most with a focal length, px."""

    focal: float
    axis: DoorAxis


@dataclass(frozen=True)
class _Edges:
    """The ends [N 2 2] of the straight edges of a video, px, in each frame: of what moves, and of
    what does not."""

    moving: list[Array]
    still: list[Array]
    intrinsics: Array
    settings: RgbSettings

    @classmethod
    def of_video(cls, video: VideoEvidence, settings: RgbSettings) -> _Edges:
        return cls(moving_edges(video.gray, video.moving, video.settings),
                   [still_edges(video.gray, video.moving, video.settings)],
                   video.intrinsics, settings)

    def planes(self, focal: float) -> tuple[EdgePlanes, EdgePlanes]:
        """Those of `moving` and of `still`."""
        k = np.array(self.intrinsics, np.float64)
        k[[0, 1], [0, 1]] = focal
        return (EdgePlanes.of_ends(self.moving, k, self.settings),
                EdgePlanes.of_ends(self.still, k, self.settings))

    def fit(self, focal: float) -> _Fit:
        """Of any axis."""
        moving, still = self.planes(focal)
        few = replace(self.settings, axes_tried=self.settings.axes_tried_by_focal)
        found = [refine_axis(moving, still, direction, self.settings)
                 for direction in propose_axes(moving, few)]
        return _Fit(focal, max(found, key=lambda axis: axis.explained))

    def fit_near(self, fit: _Fit, factors: Array) -> list[_Fit]:
        """With other focal lengths, of axes that are seen alike: their vanishing point is the
        same."""
        out: list[_Fit] = []
        for factor in factors:
            focal = float(fit.focal * factor)
            direction = fit.axis.direction * [1, 1, factor]
            direction /= np.linalg.norm(direction)
            out.append(_Fit(focal, refine_axis(*self.planes(focal), direction, self.settings)))
        return out


def _share_of(fit: _Fit) -> float:
    return fit.axis.explained
