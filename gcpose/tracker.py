"""EM over a video (Sec. 3.2): labels by all residuals so far, motion by bundle adjustment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array
from .articulation import Articulation, Cloud, Hypothesis
from .bundle import adjust
from .knowledge import Known
from .prior import Hinges
from .segment import Candidates, candidates, changed, label_costs, order_from_base, smooth
from .surface import Surfaces

_KEY = 3  # frames from one key frame to the next
_SLACK = 0.08  # how far an axis may pass from its hinge, of the object's size


class Tracker:
    """The video seen by a hypothesis: clouds of key frames whose labels follow the motion."""

    def __init__(
        self, surfaces: Surfaces, rgb: NDArray[np.uint8], known: Known, most: int
    ) -> None:
        self.surfaces, self.rgb, self.known, self.most = surfaces, rgb, known, most
        self.grids: dict[int, Candidates] = {}
        grid = self.grid(0)
        stays = label_costs(surfaces, grid, np.tile(np.eye(4), (surfaces.frames, 1, 1, 1)))
        moving = stays[:, 0] > 0.9 * (surfaces.frames - 1)
        self.moving = moving if moving.any() else ~moving
        still = ~changed(surfaces, 0)[::4, ::4] & (surfaces.depth[0, ::4, ::4] > 0)
        base = surfaces.points(0, np.argwhere(still)[:, ::-1] * 4)
        self.rank = np.zeros(len(grid.point))
        self.rank[self.moving] = order_from_base(grid.point[self.moving], base)

    def thinned(self, most: int) -> Tracker:
        """The same with fewer candidates."""
        return Tracker(self.surfaces, self.rgb, self.known, most)

    def grid(self, frame: int) -> Candidates:
        """Candidates of a key frame."""
        if frame not in self.grids:
            self.grids[frame] = candidates(self.surfaces, self.rgb, frame, self.most)
        return self.grids[frame]

    def label(self, state: Articulation, frame: int) -> tuple[Cloud, float]:
        """E-step for a frame's candidates; and their mean cost a frame."""
        grid = self.grid(frame)
        volume = label_costs(self.surfaces, grid, state.motions(len(state.angle)))
        volume = smooth(volume, grid, 4 if self.surfaces.noise else 2)
        cost = float(volume.min(axis=1).mean()) / max(1, len(state.angle) - 1)
        return Cloud(frame, grid.point, grid.normal, grid.shade, volume.argmin(axis=1)), cost

    def relabel(self, state: Articulation, frames: tuple[int, ...]) -> Hypothesis:
        """E-step for key frames."""
        both = [self.label(state, f) for f in frames]
        return Hypothesis(state, tuple(c for c, _ in both), float(np.mean([c for _, c in both])))

    def follow(self, guess: Hypothesis, until: int) -> Hypothesis:
        """Track on from the last frame of a hypothesis to frame `until`."""
        for last in range(len(guess.state.angle), until + 1):
            angle = guess.state.angle
            step = angle[-1] - angle[-2] if last > 1 else np.zeros_like(angle[-1])
            state = replace(guess.state, angle=np.concatenate([angle, angle[-1:] + step]))
            state = self.fit(guess.clouds, state, (8.0, 4.0), newest=True)
            state = self.fit(guess.clouds, state, (3.0, 1.5))
            keys = tuple(c.frame for c in guess.clouds)
            guess = self.relabel(state, (*keys, last) if last % _KEY == 0 else keys)
        return guess

    def settle(
        self, guess: Hypothesis, rounds: int, scales: tuple[float, ...] = (4.0, 2.0, 1.0)
    ) -> Hypothesis:
        """EM over the frames that a hypothesis has."""
        for _ in range(rounds):
            state = self.fit(guess.clouds, guess.state, scales)
            guess = self.relabel(state, tuple(c.frame for c in guess.clouds))
        return guess

    def hinges(self, cloud: Cloud) -> Hinges:
        """Where frame 0's labels put the joints."""
        at = hinges(cloud.point, cloud.label, self.rank, len(self.known.prismatic))
        return Hinges(at, _SLACK * extent(cloud.point[self.moving]))

    def fit(
        self,
        clouds: tuple[Cloud, ...],
        state: Articulation,
        scales: tuple[float, ...],
        newest: bool = False,
    ) -> Articulation:
        """M-step."""
        return adjust(
            self.surfaces, clouds, state, self.known.freedom, scales, self.hinges(clouds[0]), newest
        )[0]


def hinges(points: Array, label: NDArray[np.int64], rank: Array, joints: int) -> Array:
    """[J 3] about where part j meets what carries it: its points that are nearest to the base."""
    out = np.tile(points.mean(axis=0), (joints, 1))
    for j in range(joints):
        outward = np.flatnonzero((label > j) & (rank > 0))
        if len(outward):
            first = outward[np.argsort(rank[outward])[: max(3, len(points) // 50)]]
            out[j] = points[first].mean(axis=0)
    return out


def extent(points: Array) -> float:
    """Size of the points [N 3] along the camera axis they stretch most along, but for strays, m."""
    low, high = np.quantile(points, [0.04, 0.96], axis=0)
    return float((high - low).max())
