"""The planes that the camera spans with straight edges, and the directions that edges share.

An edge lies in the plane that its image and the camera span. Edges with the same direction show it
as their vanishing point does (Hartley and Zisserman, Multiple View Geometry, Sec. 8.6).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, pinhole
from ..images import VideoEvidence, moving_edges, still_edges
from .settings import RgbSettings

_MAX_PAIRS = 20000  # of edges, of which each has a vanishing point


@dataclass(frozen=True, eq=False)
class EdgePlanes:
    """The planes that the camera spans with N straight edges in T frames, in their order."""

    frames: int
    """T"""
    frame: NDArray[np.int64]
    """[N]"""
    normal: Array
    """[N 3] unit vectors"""
    change: Array
    """[N 2 3] of the normal, where one of the ends is moved by a standard deviation"""
    length: Array
    """[N] px"""

    @classmethod
    def of_ends(
        cls, ends: list[Array], intrinsics: Array, settings: RgbSettings
    ) -> EdgePlanes:
        """Return the planes of edges by their ends [N 2 2] in each of T frames, px."""
        end = np.concatenate(ends)
        ray = pinhole.pixel_rays(intrinsics, end.reshape(-1, 2)).reshape(-1, 2, 3)
        along = end[:, 1] - end[:, 0]
        length = np.linalg.norm(along, axis=1)
        across = along[:, ::-1] * [-1, 1] / float(intrinsics[0, 0]) / length[:, None]
        moved = np.pad(across, ((0, 0), (0, 1)))  # an end that is 1 px away
        normal = np.cross(ray[:, 0], ray[:, 1])
        change = np.stack([np.cross(moved, ray[:, 1]), np.cross(ray[:, 0], moved)], axis=1)
        size = np.linalg.norm(normal, axis=1)
        frame = np.repeat(np.arange(len(ends)), [len(each) for each in ends])
        return cls(len(ends), frame, normal / size[:, None],
                   settings.edge_end_sigma * change / size[:, None, None], length)

    def some(self, which: NDArray[np.bool_]) -> EdgePlanes:
        """Return those of the planes [N] that are asked for."""
        return EdgePlanes(self.frames, self.frame[which], self.normal[which], self.change[which],
                          self.length[which])

    @cached_property
    def share(self) -> Array:
        """The share [N] of each edge in the edges of its frame, by length, and of that frame in the
        frames with edges."""
        total = np.bincount(self.frame, self.length)[self.frame]
        return self.length / total / len(np.unique(self.frame))

    def fit(self, direction: Array, settings: RgbSettings) -> tuple[Array, Array, Array]:
        """Return how well the edges have a direction, [3] or one for each [N 3]: the sine [N] of
        its angle from their planes, the standard deviation [N] of this sine, and a weight [N] from
        0 to 1."""
        off = (self.normal * direction).sum(axis=1)
        by_end = (self.change * np.reshape(direction, (-1, 1, 3))).sum(axis=2)
        square = settings.edge_tilt_sigma**2 + (by_end**2).sum(axis=1)
        return off, np.sqrt(square), 1 / (1 + off**2 / (square * settings.edge_scale**2))

    def vanishing_points(self) -> Array:
        """Return directions [M 3] that two edges may have in common, of pairs of edges."""
        i, j = np.triu_indices(len(self.frame), 1)
        if len(i) > _MAX_PAIRS:
            some = np.linspace(0, len(i) - 1, _MAX_PAIRS).astype(np.int64)
            i, j = i[some], j[some]
        point = np.cross(self.normal[i], self.normal[j])
        size = np.linalg.norm(point, axis=1, keepdims=True)
        return (point / np.maximum(size, 1e-12))[size[:, 0] > 0.03]

    def common_directions(self, settings: RgbSettings) -> Array:
        """Return the directions [K 3] along which most edges are, of which any two differ."""
        points = self.vanishing_points()
        along = np.array([self.fit(point, settings)[2] @ self.share for point in points])
        return distinct_directions(points, along, settings)


def planes_of_moving_edges(video: VideoEvidence, settings: RgbSettings) -> EdgePlanes:
    """Return the planes of the straight edges in the images of what moves."""
    ends = moving_edges(video.gray, video.edge_area, video.settings)
    return EdgePlanes.of_ends(ends, video.intrinsics, settings)


def planes_of_still_edges(video: VideoEvidence, settings: RgbSettings) -> EdgePlanes:
    """Return the planes of the straight edges that do not move, as if they were of one frame."""
    ends = still_edges(video.gray, video.edge_area, video.settings)
    return EdgePlanes.of_ends([ends], video.intrinsics, settings)


def distinct_directions(directions: Array, share: Array, settings: RgbSettings) -> Array:
    """Return the directions [K 3] with the largest shares of which any two differ."""
    out: list[Array] = []
    for i in np.argsort(-share, kind="stable"):
        if all(abs(directions[i] @ other) < np.cos(settings.distinct_axis) for other in out):
            out.append(directions[i])
        if len(out) == settings.axes_tried:
            break
    return np.reshape(out, (-1, 3))
