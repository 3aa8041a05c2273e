"""Starts without flow: every joint's first step in a grid of values, judged by depth alone.

An arm that reaches for the camera moves by a hundred pixels a frame, where no flow follows it; but
its joints turn by a few degrees a frame, whatever the image does. So a coarse grid of steps, times
the places where the parts may begin, holds a start near the truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robots.geometry import Array
from ..chain import Articulation, Cloud, Grid, Hypothesis, beamed, spread, thinned
from ..images import Surfaces, smooth_costs
from ..numerics import Image
from .kernels import SweepCosts, camera_of, columns, grow, judge
from .settings import RgbdSettings
from .tracker import Tracker


def swept(tracker: Tracker, to: int, most: int) -> list[Hypothesis]:
    """The `most` best starts over frames 0 and `to`."""
    grid, known, settings = tracker.grid(0), tracker.known, tracker.settings
    tuned = settings.sweep
    inside = grid.point[tracker.moving]
    pick = np.linspace(0, len(inside) - 1, min(len(inside), tuned.points)).astype(int)
    column = columns(inside[pick], grid.normal[tracker.moving][pick])
    places = spread(thinned(inside, tuned.spread_points), tuned.places)
    reach = min(to, tuned.max_step_frames)
    steps = Grid(places, places, reach * tuned.max_turn, reach * tuned.max_slide, tuned.beam_width)
    judge = ByDepth(tracker.surfaces, to, column, settings)
    beam = beamed(known, judge, steps, settings.chain)
    found: list[Hypothesis] = []
    for twist, end, c in zip(beam.twist[:most], beam.angle[:most], beam.cost[:most].mean(axis=1),
                             strict=True):
        at = np.cross(twist[0, :3], twist[0, 3:])
        order = int(np.argmin([np.linalg.norm(b - at) for b in tracker.bases]))
        state = Articulation(twist, np.linspace(0 * end, end, to + 1), known.prismatic,
                             known.parent)
        cloud = coarse_cloud(tracker, state)
        found.append(Hypothesis(state, (cloud,), float(c), order))
    return found


def coarse_cloud(tracker: Tracker, state: Articulation) -> Cloud:
    """Frame 0's points labelled by what brings them near the last frame's surface."""
    grid, last = tracker.grid(0), len(state.angle) - 1
    motion = state.motions(last + 1)[last]
    judge = ByDepth(tracker.surfaces, last, columns(grid.point, grid.normal), tracker.settings)
    label = smooth_costs(judge.costs(motion).T, grid).argmin(axis=1)
    return Cloud(0, grid.point, grid.normal, label)


@dataclass(frozen=True)
class ByDepth:
    """Judges where points of frame 0 are found in another (see beam.py)."""

    surfaces: Surfaces
    frame: int
    column: Image
    """[6 N] points and normals"""
    settings: RgbdSettings

    @property
    def limits(self) -> SweepCosts:
        """The settings of the costs in single precision."""
        labels, sweep = self.settings.labels, self.settings.sweep
        numbers = (labels.cost_seen_through, labels.cost_hidden, labels.cost_outside,
                   sweep.pixel_sigma, sweep.noise_factor * self.surfaces.noise,
                   sweep.empty_distance)
        return SweepCosts(*(np.float32(n) for n in numbers))

    def costs(self, motion: Array) -> Image:
        surfaces = self.surfaces
        out = np.empty((len(motion), self.column.shape[1]), np.float32)
        judge(surfaces.depth[self.frame].ravel(), camera_of(surfaces.intrinsics, surfaces.depth),
              motion.astype(np.float32), self.column, self.limits, out)
        return out

    def means(self, motion: Array, turn: Array, before: Image) -> Image:
        surfaces = self.surfaces
        out = np.empty((len(motion), len(turn)), np.float32)
        grow(surfaces.depth[self.frame].ravel(), camera_of(surfaces.intrinsics, surfaces.depth),
             motion, turn, before, self.column, self.limits, out)
        return out
