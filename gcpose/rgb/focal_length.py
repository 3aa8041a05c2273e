"""The focal length of a camera that sees a door turn or a drawer slide, by their straight edges.

Edges along the axis of a door are at right angles to those across it, and the edges of a drawer and
its body are so to each other. Seen with a wrong focal length, they are not, and those of a door
differ from it in other ways as it turns (compare camera calibration by vanishing points of
directions at right angles: Caprile and Torre, Using vanishing points for camera calibration, 1990).
So the right one explains most edges.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from ...robots.geometry import Array
from ..images import VideoEvidence, moving_edges, still_edges
from .box_directions import (
    explained_share,
    find_box_directions,
    propose_box_directions,
    refine_box_directions,
)
from .door_axis import find_axis, propose_axes, refine_axis
from .edge_planes import EdgePlanes
from .settings import RgbSettings

_TRIED = np.exp(np.arange(-0.8, 1.3, 0.2))  # by that of the video; 50 deg become 92 to 16 deg
_FINER = (0.04, 0.01)  # steps of the logarithm
_STEPS = np.arange(-5, 6)


def find_focal_length(
    video: VideoEvidence, settings: RgbSettings, slides: bool = False
) -> float | None:
    """Return the focal length of a video, px; None where the edges of a door, or of a drawer if it
    `slides`, do not tell it.

    The principal point is that of the video; its focal length is where the search begins.
    """
    s, edges = settings, (_DrawerEdges if slides else _DoorEdges)(video, settings)
    if not any(map(len, edges.moving)):
        return None
    found = [edges.fit(focal) for focal in float(video.intrinsics[0, 0]) * _TRIED]
    found = sorted(found, key=_share_of)[-s.focals_kept :]
    for step in _FINER:
        found = [max(edges.fit_near(fit, np.exp(step * _STEPS)), key=_share_of) for fit in found]
    best = max(found, key=_share_of)
    others = edges.fit_near(best, np.exp([-s.focal_apart, s.focal_apart]))
    lead = _share_of(best) - max(map(_share_of, others))
    return best.focal if lead >= s.min_focal_lead and edges.confirm(best) else None


@dataclass(frozen=True)
class _Fit:
    """What explains most with a focal length, px: a direction [3], or several [K 3]."""

    focal: float
    directions: Array
    share: float


class _Edges(ABC):
    """The straight edges of a video: of what moves, and of what does not."""

    def __init__(self, video: VideoEvidence, settings: RgbSettings) -> None:
        self.moving = moving_edges(video.gray, video.edge_area, video.settings)
        self.still = [still_edges(video.gray, video.edge_area, video.settings)]
        self.intrinsics = video.intrinsics
        self.settings = settings
        self.few = replace(settings, axes_tried=settings.axes_tried_by_focal)

    def planes(self, focal: float) -> tuple[EdgePlanes, EdgePlanes]:
        """Those of `moving` and of `still`."""
        k = np.array(self.intrinsics, np.float64)
        k[[0, 1], [0, 1]] = focal
        return (EdgePlanes.of_ends(self.moving, k, self.settings),
                EdgePlanes.of_ends(self.still, k, self.settings))

    def fit(self, focal: float) -> _Fit:
        """Of any directions."""
        return max((self.refine(focal, tried) for tried in self.propose(focal)), key=_share_of)

    def fit_near(self, fit: _Fit, factors: Array) -> list[_Fit]:
        """With other focal lengths, of directions that are seen alike: their vanishing points are
        the same."""
        out: list[_Fit] = []
        for factor in factors:
            tried = fit.directions * [1, 1, factor]
            tried /= np.linalg.norm(tried, axis=-1, keepdims=True)
            out.append(self.refine(float(fit.focal * factor), tried))
        return out

    @abstractmethod
    def propose(self, focal: float) -> list[Array]:
        """Directions that may explain much."""

    @abstractmethod
    def refine(self, focal: float, directions: Array) -> _Fit:
        """The best near some directions."""

    @abstractmethod
    def confirm(self, best: _Fit) -> bool:
        """Whether the directions count as known with the best focal length."""


class _DoorEdges(_Edges):
    """The direction is the axis."""

    def propose(self, focal: float) -> list[Array]:
        return propose_axes(self.planes(focal)[0], self.few)

    def refine(self, focal: float, directions: Array) -> _Fit:
        axis = refine_axis(*self.planes(focal), directions, self.settings)
        return _Fit(focal, axis.direction, axis.explained)

    def confirm(self, best: _Fit) -> bool:
        return find_axis(*self.planes(best.focal), self.settings) is not None


class _DrawerEdges(_Edges):
    """The directions are those of the box. Edges that stand still count, too: the front alone shows
    two of them only."""

    def propose(self, focal: float) -> list[Array]:
        return propose_box_directions(self.planes(focal)[0], self.few)

    def refine(self, focal: float, directions: Array) -> _Fit:
        s, (moving, still) = self.settings, self.planes(focal)
        u, _, v = np.linalg.svd(directions)  # the nearest ones at right angles
        box = refine_box_directions(moving, still, u @ v, s)
        share = s.still_edge_weight * explained_share(still, box.axes, s) + box.explained
        return _Fit(focal, box.axes, share / (1 + s.still_edge_weight))

    def confirm(self, best: _Fit) -> bool:
        return (best.share >= self.settings.min_box_focal_share
                and find_box_directions(*self.planes(best.focal), self.settings) is not None)


def _share_of(fit: _Fit) -> float:
    return fit.share
