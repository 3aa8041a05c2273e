"""Starts from depth alone: a beam search over a grid of every joint's first step.

An arm that moves toward the camera moves by a hundred pixels from frame to frame, which flow cannot
follow. But its joints turn by a few degrees. So a coarse grid of steps, times places where the
parts may begin, holds a start near the truth.
"""

from __future__ import annotations

import numpy as np

from ...robots.geometry import Array
from ..chain import Articulation, StepCosts, StepGrid, beam_search, spread_places
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
    places = spread_places(points, tuned.places, tuned.spread_points)
    reach = min(to, tuned.max_step_frames)
    steps = StepGrid(places, places, reach * tuned.max_turn, reach * tuned.max_slide,
                     tuned.beam_width)
    costs = depth_step_costs(evidence.surfaces, to, columns(points[pick], normals[pick]), settings)
    beam = beam_search(priors, costs, steps, settings.chain)
    found: list[DepthHypothesis] = []
    cost = beam.cost[:most].mean(axis=1)
    for state, own in zip(beam.articulations(priors, to, most), cost, strict=True):
        foot = np.cross(state.twist[0, :3], state.twist[0, 3:])
        base = min(evidence.base_candidates, key=lambda b: float(np.linalg.norm(b - foot)))
        clouds = Clouds([label_coarsely(evidence, state)])
        found.append(Hypothesis(state, clouds, base, float(own)))
    return found


def label_coarsely(evidence: RgbdEvidence, state: Articulation) -> Cloud:
    """Label the candidates of frame 0 by their distance from the surface of the last frame."""
    grid, last = evidence.grid(0), len(state.angle) - 1
    costs = depth_step_costs(evidence.surfaces, last, columns(grid.point, grid.normal),
                             evidence.settings)
    volume = smooth_costs(costs.costs(state.motions(last + 1)[last]).T, grid)
    return Cloud(0, grid.point, grid.normal, volume.argmin(axis=1))


def depth_step_costs(
    surfaces: Surfaces, frame: int, column: Image, settings: RgbdSettings
) -> StepCosts:
    """Return the costs in a frame, variances, of points of frame 0: columns [6 N] of points and
    normals, camera frame, m."""
    labels, sweep = settings.labels, settings.sweep
    numbers = SweepCosts(*(np.float32(n) for n in (
        labels.cost_seen_through, labels.cost_hidden, labels.cost_outside, sweep.pixel_sigma,
        sweep.noise_factor * surfaces.noise)))
    depth, camera = surfaces.depth[frame].ravel(), flat_camera(surfaces)

    def fill_costs(motion: Array, out: Image) -> None:
        fill_step_costs(depth, camera, motion.astype(np.float32), column, numbers, out)

    def fill_means(motion: Array, turn: Array, before: Image, out: Image) -> None:
        fill_mean_costs(depth, camera, motion, turn, before, column, numbers, out)

    return StepCosts(column.shape[1], fill_costs, fill_means)
