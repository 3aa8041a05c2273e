"""Starts from depth alone: a beam search over a grid of every joint's first step.

An arm that moves toward the camera moves by a hundred pixels from frame to frame, which flow cannot
follow. But its joints turn by a few degrees. So a coarse grid of steps, times places where the
parts may begin, holds a start near the truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robots.geometry import Array
from ..chain import Articulation, StepGrid, beam_search, spread_places, subsample
from ..estimator import Hypothesis
from ..images import Surfaces, smooth_costs
from ..numerics import Image
from .evidence import DepthHypothesis, RgbdEvidence
from .kernels import SweepCosts, columns, fill_mean_costs, fill_step_costs, flat_camera
from .labels import Cloud, Clouds
from .settings import RgbdSettings


def sweep_depth(evidence: RgbdEvidence, to: int, most: int) -> list[DepthHypothesis]:
    """Return the `most` best starts over frames 0 and `to`."""
    grid, priors, settings = evidence.grid(0), evidence.priors, evidence.settings
    tuned = settings.sweep
    points, normals = grid.point[evidence.moving], grid.normal[evidence.moving]
    pick = np.linspace(0, len(points) - 1, min(len(points), tuned.points)).astype(int)
    places = spread_places(subsample(points, tuned.spread_points), tuned.places)
    reach = min(to, tuned.max_step_frames)
    steps = StepGrid(places, places, reach * tuned.max_turn, reach * tuned.max_slide,
                     tuned.beam_width)
    costs = DepthStepCosts(evidence.surfaces, to, columns(points[pick], normals[pick]), settings)
    beam = beam_search(priors, costs, steps, settings.chain)
    found: list[DepthHypothesis] = []
    for twist, end, cost in zip(beam.twist[:most], beam.angle[:most],
                                beam.cost[:most].mean(axis=1), strict=True):
        foot = np.cross(twist[0, :3], twist[0, 3:])
        base = min(evidence.base_candidates, key=lambda b: float(np.linalg.norm(b - foot)))
        state = Articulation(twist, np.linspace(0 * end, end, to + 1), priors.prismatic,
                             priors.parent)
        clouds = Clouds([label_coarsely(evidence, state)])
        found.append(Hypothesis(state, clouds, base, float(cost)))
    return found


def label_coarsely(evidence: RgbdEvidence, state: Articulation) -> Cloud:
    """Label the candidates of frame 0 by their distance from the surface of the last frame."""
    grid, last = evidence.grid(0), len(state.angle) - 1
    costs = DepthStepCosts(evidence.surfaces, last, columns(grid.point, grid.normal),
                           evidence.settings)
    volume = smooth_costs(costs.costs(state.motions(last + 1)[last]).T, grid)
    return Cloud(0, grid.point, grid.normal, volume.argmin(axis=1))


@dataclass(frozen=True)
class DepthStepCosts:
    """Costs of points of frame 0 in another frame (see `chain.beam.StepCosts`)."""

    surfaces: Surfaces
    frame: int
    column: Image
    """[6 N] points and normals, camera frame, m"""
    settings: RgbdSettings

    def costs(self, motion: Array) -> Image:
        """Return [M N] costs under each of motion [M 4 4], variances."""
        out = np.empty((len(motion), self.column.shape[1]), np.float32)
        fill_step_costs(self.surfaces.depth[self.frame].ravel(), flat_camera(self.surfaces),
                        motion.astype(np.float32), self.column, self._numbers(), out)
        return out

    def means(self, motion: Array, turn: Array, before: Image) -> Image:
        """Return [M P] mean costs of chains with one more part."""
        out = np.empty((len(motion), len(turn)), np.float32)
        fill_mean_costs(self.surfaces.depth[self.frame].ravel(), flat_camera(self.surfaces),
                        motion, turn, before, self.column, self._numbers(), out)
        return out

    def _numbers(self) -> SweepCosts:
        """Return the settings in single precision."""
        labels, sweep = self.settings.labels, self.settings.sweep
        numbers = (labels.cost_seen_through, labels.cost_hidden, labels.cost_outside,
                   sweep.pixel_sigma, sweep.noise_factor * self.surfaces.noise)
        return SweepCosts(*(np.float32(n) for n in numbers))
