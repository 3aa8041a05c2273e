"""Evidence of depth: candidates of the moving parts, their labels, and their residuals."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import HingePrior, JointPriors, extent, locate_hinges
from ..estimator import Adjustment, Hypothesis, Round, label_difference, select_distinct, track
from ..images import Surfaces, geodesic_rank, smooth_costs
from ..numerics import Solver
from .labels import (
    Candidates,
    Cloud,
    Clouds,
    changed_mask,
    label_costs,
    part_centers,
    sample_candidates,
)
from .residuals import SurfaceResiduals, cloud_surfels
from .settings import RgbdSettings

DepthHypothesis = Hypothesis[Clouds]


@dataclass(frozen=True)
class Labeling:
    """How candidates get labels."""

    width: float = 1.0
    """Standard deviation of a candidate's place, footprints"""
    added: tuple[int, ...] = ()
    """New key frames"""


DepthRound = Round[Adjustment, Labeling]


class RgbdEvidence:
    """A video with depth (see `estimator.Evidence`)."""

    def __init__(
        self, surfaces: Surfaces, rgb: NDArray[np.uint8], moving_mask: NDArray[np.bool_],
        priors: JointPriors, settings: RgbdSettings, most: int = 0,
    ) -> None:
        """Prepare a video with images [T H W 3] and pixels that may show a moving part [T H W];
        `most` is the number of candidates of a frame (default: as in the settings)."""
        tuned = settings.bundle
        self.settings, self.chain = settings, settings.chain
        self.solver = Solver(tuned.damping, tuned.damping_floor, max_step=tuned.max_step)
        self.surfaces, self.rgb, self.moving_mask, self.priors = surfaces, rgb, moving_mask, priors
        self.most = most or (settings.candidates_noisy if surfaces.noise else settings.candidates)
        self._grids: dict[int, Candidates] = {}
        self._static_costs: dict[tuple[int, int, float], Array] = {}
        grid = self.grid(0)
        at_rest = np.tile(np.eye(4), (surfaces.frames, 1, 1, 1))
        cost = label_costs(surfaces, grid, at_rest, settings)
        moving = cost[:, 0] > settings.tracker.moving_cost * (surfaces.frames - 1)
        self.moving = moving if moving.any() else ~moving
        """[N] candidates of frame 0 that move"""
        self.ranks = tuple(self._ranks(self._static_points(grid, cost)))
        """[N] geodesic rank of candidates of frame 0, for each candidate of the base"""
        inside, share = grid.point[self.moving], settings.tracker.base_share
        self.base_candidates = tuple(
            inside[rank[self.moving] <= share].mean(axis=0) for rank in self.ranks)
        """[3] where the chain may begin, for each of them"""

    def _static_points(self, grid: Candidates, cost: Array) -> Array:
        """Return static points [M 3] of frame 0; if the base is hidden, the candidates with the
        least cost [N 1] of standing still."""
        surfaces, tuned = self.surfaces, self.settings.tracker
        step = tuned.base_stride
        static = ~changed_mask(surfaces, 0)[::step, ::step]
        static &= surfaces.depth[0, ::step, ::step] > 0
        points = surfaces.points(0, np.argwhere(static)[:, ::-1] * step)
        if len(points) < tuned.min_base_points:
            mean = smooth_costs(cost, grid)[:, 0]
            points = grid.point[mean <= np.quantile(mean, tuned.base_share)]
        return points

    def _ranks(self, base: Array) -> list[Array]:
        """Return geodesic ranks [N] of the candidates of frame 0, for each candidate of the base.

        As a rule the base is what moves next to static points [M 3]. But a hand may be close to a
        table, and then the base is at the other end of what moves.
        """
        points, tuned = self.grid(0).point[self.moving], self.settings.tracker
        found, start = [], base
        for _ in range(tuned.base_candidates):
            rank = geodesic_rank(points, start, self.surfaces.settings)
            start = points[rank >= np.quantile(rank, tuned.far_rank)]
            if all(np.corrcoef(rank, other)[0, 1] < tuned.max_rank_correlation for other in found):
                found.append(rank)
        out: list[Array] = []
        for rank in found:
            out.append(np.zeros(len(self.moving)))
            out[-1][self.moving] = rank
        return out

    def coarser(self, most: int) -> RgbdEvidence:
        """Return evidence with fewer candidates and the same candidates of the base."""
        out = RgbdEvidence(
            self.surfaces, self.rgb, self.moving_mask, self.priors, self.settings, most)
        out.base_candidates = self.base_candidates
        return out

    def without_flow(self) -> RgbdEvidence:
        """Return the evidence of depth alone."""
        out = copy(self)
        out.surfaces = replace(self.surfaces, flow=None)
        return out

    def grid(self, frame: int) -> Candidates:
        """Return the candidates of a frame."""
        if frame not in self._grids:
            mask = self.moving_mask[frame]
            self._grids[frame] = sample_candidates(self.surfaces, mask, frame, self.most)
        return self._grids[frame]

    def label_frame(self, motion: Array, frame: int, width: float = 1.0) -> tuple[Cloud, float]:
        """Label a frame's candidates under motions [T J+1 4 4]; return them, and their mean cost by
        frame in variances."""
        grid = self.grid(frame)
        volume = smooth_costs(self.label_costs(motion, frame, width), grid, self.surfaces.noise > 0)
        cost = float(volume.min(axis=1).mean()) / max(1, len(motion) - 1)
        return Cloud(frame, grid.point, grid.normal, volume.argmin(axis=1)), cost

    def label_costs(self, motion: Array, frame: int, width: float) -> Array:
        """Return the costs [N J+1] of a frame's candidates. Those of part 0 are computed once."""
        grid, key = self.grid(frame), (frame, len(motion), width)
        if key not in self._static_costs:
            self._static_costs[key] = label_costs(
                self.surfaces, grid, motion[:, :1], self.settings, width)
        moving = label_costs(self.surfaces, grid, motion[:, 1:], self.settings, width, 1)
        return np.concatenate([self._static_costs[key], moving], axis=1)

    def unexplained_share(self, hypothesis: DepthHypothesis) -> float:
        """Return the share of the candidates that no part moves to a measured surface."""
        width = 1.0 if self.surfaces.noise else self.settings.refine.sharp_width
        last = len(hypothesis.state.angle) - 1
        motion = hypothesis.state.motions(last + 1)
        cost = np.concatenate([self.label_costs(motion, cloud.frame, width).min(axis=1)
                               for cloud in hypothesis.points])
        return float((cost > self.settings.tracker.unexplained_cost * last).mean())

    def label(self, hypothesis: DepthHypothesis, where: Labeling) -> DepthHypothesis:
        """Label the key frames of a hypothesis, and those that are added (E-step)."""
        motion = hypothesis.state.motions(len(hypothesis.state.angle))
        frames = *(c.frame for c in hypothesis.points), *where.added
        both = [self.label_frame(motion, frame, where.width) for frame in frames]
        cost = float(np.mean([c for _, c in both]))
        return replace(hypothesis, points=Clouds(c for c, _ in both), cost=cost)

    def measure(self, hypothesis: DepthHypothesis, how: Adjustment) -> SurfaceResiduals:
        """Return the residuals of the points of a hypothesis; robust scales are in footprints."""
        tuned, parts = self.settings.bundle, len(hypothesis.state.parent) + 1
        return SurfaceResiduals(self.surfaces, hypothesis.points, tuple(
            cloud_surfels(self.surfaces, cloud, parts, tuned.min_part_points)
            for cloud in hypothesis.points), tuned)

    def em_round(
        self, scales: tuple[float, ...] = (), fixed_axes: bool = False, width: float = 1.0
    ) -> DepthRound:
        """Return a round of EM, with the least width of its labels."""
        scales = scales or self.settings.tracker.em_scales
        return (Adjustment(scales, fixed_axes),), Labeling(max(width, scales[-1]))

    def track(
        self, hypothesis: DepthHypothesis, until: int, scales: tuple[float, ...] = (),
        fixed_axes: bool = False,
    ) -> DepthHypothesis:
        """Extend a hypothesis to frame `until`: first each new frame alone, then with all."""
        tuned = self.settings.tracker
        scales = scales or tuned.track_scales
        both = Adjustment(tuned.extend_scales, newest=True), Adjustment(scales, fixed_axes)

        def rounds_of(extended: DepthHypothesis) -> list[DepthRound]:
            last = len(extended.state.angle) - 1
            added = () if last % tuned.key_frame_step else (last,)
            return [(both, Labeling(max(1.0, scales[-1]), added))]

        return track(self, hypothesis, until, rounds_of)

    def hinges(self, hypothesis: DepthHypothesis) -> HingePrior:
        """Return where the labels of frame 0 put the hinges."""
        cloud, chain = hypothesis.points[0], self.settings.chain
        at = locate_hinges(cloud.point, cloud.label, hypothesis.base, self.priors.parent, chain)
        size = extent(cloud.point[self.moving], chain)
        slack = self.settings.tracker.hinge_slack * size
        return HingePrior(at, slack, part_centers(cloud, len(at)))

    def select(self, found: list[DepthHypothesis], most: int) -> list[DepthHypothesis]:
        """Return the `most` best whose labels of frame 0 differ in more than a share of them."""
        share = self.chain.distinct_labels
        return select_distinct(found, most, lambda one, two: label_difference(one, two) > share)
