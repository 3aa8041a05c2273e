"""EM over a video (Sec. 3.2): labels by all residuals so far, motion by bundle adjustment."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import Articulation, Cloud, Hinges, Hypothesis, Known, extent, hinges
from ..images import Surfaces, order_from_base, smooth
from .bundle import adjust
from .labels import Candidates, candidates, changed, label_costs

_KEY = 3  # frames from one key frame to the next
_UNEXPLAINED = 2.0  # cost a frame
_SEEN = 20  # sampled pixels of what stands still, for it to be taken for the base
_SLACK = 0.08  # how far an axis may pass from its hinge, of the object's size


class Tracker:
    """The video seen by a hypothesis: clouds of key frames whose labels follow the motion."""

    def __init__(
        self, surfaces: Surfaces, rgb: NDArray[np.uint8], lively: NDArray[np.bool_],
        known: Known, most: int,
    ) -> None:
        """Images [T H W 3], what is lively in them [T H W], and how many candidates a frame has."""
        self.surfaces, self.rgb, self.lively, self.known = surfaces, rgb, lively, known
        self.most = most
        self.grids: dict[int, Candidates] = {}
        self.stays: dict[tuple[int, int, float], Array] = {}
        grid = self.grid(0)
        stays = label_costs(surfaces, grid, np.tile(np.eye(4), (surfaces.frames, 1, 1, 1)))
        moving = stays[:, 0] > 0.9 * (surfaces.frames - 1)
        self.moving = moving if moving.any() else ~moving
        still = ~changed(surfaces, 0)[::4, ::4] & (surfaces.depth[0, ::4, ::4] > 0)
        base = surfaces.points(0, np.argwhere(still)[:, ::-1] * 4)
        if len(base) < _SEEN:  # the base is hidden: what moves least is nearest to it
            calm = smooth(stays, grid)[:, 0]
            base = grid.point[calm <= np.quantile(calm, 0.03)]
        self.ranks = tuple(self._ranks(base))
        inside = grid.point[self.moving]
        self.bases = tuple(inside[r[self.moving] <= 0.03].mean(axis=0) for r in self.ranks)

    def _ranks(self, base: Array) -> list[Array]:
        """[N] each: how far out a point of frame 0 is, if the base is here, there, or there.

        What stands still is nearest to the base as a rule; but a hand may hover over a table, and
        then the base is at one end of what moves.
        """
        points = self.grid(0).point[self.moving]
        found, start = [], base
        for _ in range(3):
            rank = order_from_base(points, start)
            start = points[rank >= np.quantile(rank, 0.98)]  # the other end
            if all(np.corrcoef(rank, other)[0, 1] < 0.9 for other in found):
                found.append(rank)
        out: list[Array] = []
        for rank in found:
            out.append(np.zeros(len(self.moving)))
            out[-1][self.moving] = rank
        return out

    def thinned(self, most: int) -> Tracker:
        """The same with fewer candidates."""
        out = Tracker(self.surfaces, self.rgb, self.lively, self.known, most)
        out.bases = self.bases  # a hypothesis means the same base to both
        return out

    def flowless(self) -> Tracker:
        """The same by depth alone."""
        out = copy(self)
        out.surfaces = replace(self.surfaces, flow=None)
        return out

    def grid(self, frame: int) -> Candidates:
        """Candidates of a key frame."""
        if frame not in self.grids:
            self.grids[frame] = candidates(self.surfaces, self.lively[frame], frame, self.most)
        return self.grids[frame]

    def label(self, state: Articulation, frame: int, width: float = 1.0) -> tuple[Cloud, float]:
        """E-step for a frame's candidates; and their mean cost a frame."""
        return self.label_motion(state.motions(len(state.angle)), frame, width)

    def label_motion(self, motion: Array, frame: int, width: float) -> tuple[Cloud, float]:
        """The same for any motion [T J+1 4 4] of the parts."""
        grid = self.grid(frame)
        volume = smooth(self.label_costs(motion, frame, width), grid, self.surfaces.noise > 0)
        cost = float(volume.min(axis=1).mean()) / max(1, len(motion) - 1)
        return Cloud(frame, grid.point, grid.normal, volume.argmin(axis=1)), cost

    def label_costs(self, motion: Array, frame: int, width: float) -> Array:
        """[N J+1] of a frame's candidates; what part 0 costs them is always the same."""
        grid, key = self.grid(frame), (frame, len(motion), width)
        if key not in self.stays:
            self.stays[key] = label_costs(self.surfaces, grid, motion[:, :1], width)
        moves = label_costs(self.surfaces, grid, motion[:, 1:], width, 1)
        return np.concatenate([self.stays[key], moves], axis=1)

    def unexplained(self, guess: Hypothesis, width: float) -> float:
        """Share of the candidates that no part brings to where the frames show something."""
        state, bad = guess.state, []
        for cloud in guess.clouds:
            volume = self.label_costs(state.motions(len(state.angle)), cloud.frame, width)
            bad.append(volume.min(axis=1) > _UNEXPLAINED * (len(state.angle) - 1))
        return float(np.concatenate(bad).mean())

    def relabel(
        self, state: Articulation, frames: tuple[int, ...], order: int, width: float = 1.0
    ) -> Hypothesis:
        """E-step for key frames."""
        both = [self.label(state, f, width) for f in frames]
        cost = float(np.mean([c for _, c in both]))
        return Hypothesis(state, tuple(c for c, _ in both), cost, order)

    def follow(
        self,
        guess: Hypothesis,
        until: int,
        scales: tuple[float, ...] = (3.0, 1.5),
        held: bool = False,
    ) -> Hypothesis:
        """Track on from the last frame of a hypothesis to frame `until`."""
        for last in range(len(guess.state.angle), until + 1):
            angle = guess.state.angle
            step = angle[-1] - angle[-2] if last > 1 else np.zeros_like(angle[-1])
            state = replace(guess.state, angle=np.concatenate([angle, angle[-1:] + step]))
            state = self.fit(guess, state, (8.0, 4.0), newest=True)
            state = self.fit(guess, state, scales, held=held)
            keys = tuple(c.frame for c in guess.clouds)
            keys = (*keys, last) if last % _KEY == 0 else keys
            guess = self.relabel(state, keys, guess.order, max(1.0, scales[-1]))
        return guess

    def settle(
        self,
        guess: Hypothesis,
        rounds: int,
        scales: tuple[float, ...] = (4.0, 2.0, 1.0),
        held: bool = False,
        sharp: float = 1.0,
    ) -> Hypothesis:
        """EM over the frames that a hypothesis has; labels within `sharp` footprints at least."""
        for _ in range(rounds):
            state = self.fit(guess, guess.state, scales, held=held)
            frames = tuple(c.frame for c in guess.clouds)
            guess = self.relabel(state, frames, guess.order, max(sharp, scales[-1]))
        return guess

    def hinges(self, guess: Hypothesis) -> Hinges:
        """Where frame 0's labels put the joints."""
        cloud = guess.clouds[0]
        at = hinges(cloud.point, cloud.label, self.bases[guess.order], self.known.parent)
        return Hinges(at, _SLACK * extent(cloud.point[self.moving]))

    def fit(
        self,
        guess: Hypothesis,
        state: Articulation,
        scales: tuple[float, ...],
        newest: bool = False,
        held: bool = False,
    ) -> Articulation:
        """M-step; with `held` axes stay where they are."""
        freedom = 0 if held else self.known.freedom
        hinges = self.hinges(guess)
        return adjust(self.surfaces, guess.clouds, state, freedom, scales, hinges, newest)[0]
