"""Evidence of noisy depth and of images: one motion explains both.

Depth tells where each surface is, images how its texture moves. Motions are in metres, as
depth tells them; images see them in units of the distance of the object.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import Articulation, HingePrior, scale_twists
from ..estimator import BundleEquations, Hypothesis
from ..rgb import (
    InverseDepthPoints,
    RayResiduals,
    RgbEvidence,
    SampledPixels,
    VideoAdjustment,
    VideoHypothesis,
    start_points,
)
from ..rgbd import Clouds, DepthHypothesis, Labeling, RgbdEvidence, SurfaceResiduals
from .settings import FusionSettings


def in_unit(state: Articulation, unit: float) -> Articulation:
    """Return a motion in metres in another unit of length, m."""
    return replace(state, twist=scale_twists(state.twist, state.prismatic, 1 / unit),
                   angle=state.angle / np.where(state.prismatic, unit, 1.0))


@dataclass(frozen=True)
class FusedPoints:
    """Points of surfaces, and pixels with an unknown depth."""

    surface: Clouds
    pixel: InverseDepthPoints

    @property
    def label(self) -> NDArray[np.int64]:
        """[N] parts of the pixels"""
        return self.pixel.label


FusedHypothesis = Hypothesis[FusedPoints]


@dataclass(frozen=True)
class FusedResiduals:
    """Distances from measured surfaces, m, and from places in the images, px (see `Residuals`)."""

    by_depth: SurfaceResiduals
    by_images: RayResiduals
    unit: float
    """Unit of length of the images, m"""
    settings: FusionSettings

    @property
    def points(self) -> FusedPoints:
        """The points of both."""
        return FusedPoints(self.by_depth.points, self.by_images.points)

    def linearize(
        self, state: Articulation, basis: tuple[Array, ...], scale: float,
        prior: tuple[Array, Array],
    ) -> tuple[BundleEquations, Callable[[Array], FusedResiduals]]:
        """Return the sum of the equations of both; the scale is that of the images."""
        s, weight = self.settings, self.settings.image_weight
        depth, _ = self.by_depth.linearize(state, basis, s.depth_scale * scale, prior)
        there = tuple(scale_twists(b.T, np.full(b.shape[1], p), 1 / self.unit).T
                      for b, p in zip(basis, state.prismatic, strict=True))
        images, after = self.by_images.linearize(
            in_unit(state, self.unit), there, scale, (0 * prior[0], 0 * prior[1]))
        by = np.ones(len(prior[1]))  # a slide counts in the unit of the images there
        by[: state.angle[1:].size] = np.tile(
            np.where(state.prismatic, 1 / self.unit, 1.0), len(state.angle) - 1)
        square = weight * images.matrix * by[:, None] * by
        assert depth.scatter is not None and images.diagonal is not None
        both = BundleEquations(
            depth.matrix + square, depth.vector + weight * images.vector * by,
            depth.scatter + square, np.diag(depth.matrix) + weight * images.diagonal * by**2)
        return both, lambda step: replace(self, by_images=after(step * by))


class FusedEvidence:
    """A video with noisy depth (see `estimator.Evidence`)."""

    def __init__(
        self, depth: RgbdEvidence, images: RgbEvidence, unit: float, settings: FusionSettings
    ) -> None:
        """Join evidence of depth, in metres, and of images, in a unit of length, m."""
        self.depth, self.images, self.unit, self.settings = depth, images, unit, settings
        self.priors, self.solver, self.chain = depth.priors, depth.solver, depth.chain

    def by_depth(self, hypothesis: FusedHypothesis) -> DepthHypothesis:
        """Return the part of a hypothesis that depth sees."""
        h = hypothesis
        return DepthHypothesis(h.state, h.points.surface, h.base, h.cost)

    def by_images(self, hypothesis: FusedHypothesis) -> VideoHypothesis:
        """Return the part of a hypothesis that the images see."""
        h = hypothesis
        return VideoHypothesis(in_unit(h.state, self.unit), h.points.pixel, h.base / self.unit,
                               h.cost, penalty=h.penalty)

    def begin(
        self, state: Articulation, like: DepthHypothesis, pixels: SampledPixels
    ) -> FusedHypothesis:
        """Return a hypothesis of a motion in metres, with the base and key frames of another."""
        points = FusedPoints(like.points, start_points(pixels))
        return self.label(FusedHypothesis(state, points, like.base, np.inf), pixels)

    def hinges(self, hypothesis: FusedHypothesis) -> HingePrior:
        """Return where the labels of depth put the hinges, m."""
        return self.depth.hinges(self.by_depth(hypothesis))

    def measure(self, hypothesis: FusedHypothesis, how: VideoAdjustment) -> FusedResiduals:
        """Measure the points of both."""
        return FusedResiduals(
            self.depth.measure(self.by_depth(hypothesis), how),
            self.images.measure(self.by_images(hypothesis), how), self.unit, self.settings)

    def label(self, hypothesis: FusedHypothesis, pixels: SampledPixels) -> FusedHypothesis:
        """Label the points of both (E-step); the cost is that of depth, the penalty that of the
        images."""
        depth = self.depth.label(self.by_depth(hypothesis), Labeling())
        images = self.images.label(self.by_images(hypothesis), pixels)
        return replace(hypothesis, points=FusedPoints(depth.points, images.points),
                       cost=depth.cost, penalty=images.penalty)
