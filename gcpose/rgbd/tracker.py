"""EM over a video (Sec. 3.2): labels by all residuals so far, motion by bundle adjustment."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import Articulation, Cloud, Hinges, Hypothesis, Known, extent, hinges
from ..images import Surfaces, geodesic_rank, smooth_costs
from .bundle import Views, adjust
from .labels import Candidates, candidates, changed, label_costs
from .settings import RgbdSettings


class Tracker:
    """The video seen by a hypothesis: clouds of key frames whose labels follow the motion."""

    def __init__(
        self, surfaces: Surfaces, rgb: NDArray[np.uint8], lively: NDArray[np.bool_],
        known: Known, settings: RgbdSettings, most: int = 0,
    ) -> None:
        """Images [T H W 3], what is lively in them [T H W], and how many candidates a frame has
        (default: as the settings have it)."""
        self.settings = settings
        self.surfaces, self.rgb, self.lively, self.known = surfaces, rgb, lively, known
        self.most = most or (
            settings.candidates_noisy if surfaces.noise else settings.candidates)
        self.grids: dict[int, Candidates] = {}
        self.stays: dict[tuple[int, int, float], Array] = {}
        grid = self.grid(0)
        still = np.tile(np.eye(4), (surfaces.frames, 1, 1, 1))
        stays = label_costs(surfaces, grid, still, settings)
        tuned = settings.tracker
        moving = stays[:, 0] > tuned.moving_cost * (surfaces.frames - 1)
        self.moving = moving if moving.any() else ~moving
        step = tuned.base_stride
        fixed = ~changed(surfaces, 0)[::step, ::step] & (surfaces.depth[0, ::step, ::step] > 0)
        base = surfaces.points(0, np.argwhere(fixed)[:, ::-1] * step)
        if len(base) < tuned.min_base_points:
            # the base is hidden: what moves least is nearest to it
            calm = smooth_costs(stays, grid)[:, 0]
            base = grid.point[calm <= np.quantile(calm, tuned.base_share)]
        self.ranks = tuple(self._ranks(base))
        inside = grid.point[self.moving]
        self.bases = tuple(
            inside[r[self.moving] <= tuned.base_share].mean(axis=0) for r in self.ranks)

    def _ranks(self, base: Array) -> list[Array]:
        """[N] each: how far out a point of frame 0 is, if the base is here, there, or there.

        What stands still is nearest to the base as a rule; but a hand may hover over a table, and
        then the base is at one end of what moves.
        """
        points = self.grid(0).point[self.moving]
        found, start = [], base
        tuned = self.settings.tracker
        for _ in range(tuned.base_candidates):
            rank = geodesic_rank(points, start, self.surfaces.settings)
            start = points[rank >= np.quantile(rank, tuned.far_rank)]  # the other end
            if all(np.corrcoef(rank, other)[0, 1] < tuned.max_rank_correlation for other in found):
                found.append(rank)
        out: list[Array] = []
        for rank in found:
            out.append(np.zeros(len(self.moving)))
            out[-1][self.moving] = rank
        return out

    def thinned(self, most: int) -> Tracker:
        """The same with fewer candidates."""
        out = Tracker(self.surfaces, self.rgb, self.lively, self.known, self.settings, most)
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
        volume = smooth_costs(self.label_costs(motion, frame, width), grid, self.surfaces.noise > 0)
        cost = float(volume.min(axis=1).mean()) / max(1, len(motion) - 1)
        return Cloud(frame, grid.point, grid.normal, volume.argmin(axis=1)), cost

    def label_costs(self, motion: Array, frame: int, width: float) -> Array:
        """[N J+1] of a frame's candidates; what part 0 costs them is always the same."""
        grid, key = self.grid(frame), (frame, len(motion), width)
        if key not in self.stays:
            self.stays[key] = label_costs(self.surfaces, grid, motion[:, :1], self.settings,
                                           width)
        moves = label_costs(self.surfaces, grid, motion[:, 1:], self.settings, width, 1)
        return np.concatenate([self.stays[key], moves], axis=1)

    def unexplained(self, guess: Hypothesis, width: float) -> float:
        """Share of the candidates that no part brings to where the frames show something."""
        state, bad = guess.state, []
        most = self.settings.tracker.unexplained_cost * (len(state.angle) - 1)
        for cloud in guess.clouds:
            volume = self.label_costs(state.motions(len(state.angle)), cloud.frame, width)
            bad.append(volume.min(axis=1) > most)
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
        scales: tuple[float, ...] = (),
        held: bool = False,
    ) -> Hypothesis:
        """Track on from the last frame of a hypothesis to frame `until`."""
        tuned = self.settings.tracker
        scales = scales or tuned.follow_scales
        for last in range(len(guess.state.angle), until + 1):
            angle = guess.state.angle
            step = angle[-1] - angle[-2] if last > 1 else np.zeros_like(angle[-1])
            state = replace(guess.state, angle=np.concatenate([angle, angle[-1:] + step]))
            state = self.fit(guess, state, tuned.extend_scales, newest=True)
            state = self.fit(guess, state, scales, held=held)
            keys = tuple(c.frame for c in guess.clouds)
            keys = (*keys, last) if last % tuned.key_frame_step == 0 else keys
            guess = self.relabel(state, keys, guess.order, max(1.0, scales[-1]))
        return guess

    def settle(
        self,
        guess: Hypothesis,
        rounds: int,
        scales: tuple[float, ...] = (),
        held: bool = False,
        sharp: float = 1.0,
    ) -> Hypothesis:
        """EM over the frames that a hypothesis has; labels within `sharp` footprints at least."""
        scales = scales or self.settings.tracker.settle_scales
        for _ in range(rounds):
            state = self.fit(guess, guess.state, scales, held=held)
            frames = tuple(c.frame for c in guess.clouds)
            guess = self.relabel(state, frames, guess.order, max(sharp, scales[-1]))
        return guess

    def hinges(self, guess: Hypothesis) -> Hinges:
        """Where frame 0's labels put the joints."""
        cloud = guess.clouds[0]
        chain = self.settings.chain
        at = hinges(cloud.point, cloud.label, self.bases[guess.order], self.known.parent, chain)
        return Hinges(at, self.settings.tracker.hinge_slack
                      * extent(cloud.point[self.moving], chain))

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
        views = Views(self.surfaces, guess.clouds, self.hinges(guess))
        return adjust(views, state, freedom, scales, self.settings, newest)[0]
