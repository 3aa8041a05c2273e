"""Evidence of plain video: sampled pixels, their labels, and residuals by flow and patches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...robots.geometry import Array, inverse
from ..chain import (
    Articulation,
    HingePrior,
    JointPriors,
    locate_hinges,
    offset_from_axis,
    scale_twists,
)
from ..estimator import Adjustment, Hypothesis, Round, run_em, track
from ..images import VideoEvidence, geodesic_rank
from ..numerics import Image, Solver
from .box_directions import BoxDirections, find_box_directions
from .costs import MovedRays, flow_costs, flow_records, patch_costs
from .door_axis import DoorAxis, find_axis
from .door_edges import DoorEdges, see_edges
from .edge_planes import EdgePlanes, planes_of_moving_edges, planes_of_still_edges
from .labels import (
    SampledPixels,
    assign_labels,
    average_along_tracks,
    label_inversions,
    sample_pixels,
)
from .measurements import (
    add_tracks,
    drop_points_at_rest,
    measure_flow,
    measure_patches,
    patch_misfit,
    track_misfit,
)
from .outline import OutlineKind
from .points import InverseDepthPoints, interpolate_depths, motions_from_frames
from .projection import project_rays
from .residuals import RayResiduals, smoothness_blocks
from .settings import RgbSettings

VideoHypothesis = Hypothesis[InverseDepthPoints]
PACE_STEPS = 2
"""Last steps whose mean pace is extrapolated while tracking."""


@dataclass(frozen=True)
class VideoAdjustment(Adjustment):
    """How points are measured and adjusted."""

    depth_sigma: float = 0.5
    """Standard deviation of inverse depths about the expected ones"""
    patches: tuple[float, int] | None = None
    """Search radius of patches, px, and frames before and after their own in which they are
    searched; None: by flow instead"""


VideoRound = Round[VideoAdjustment, SampledPixels]


def places_at_start(hypothesis: VideoHypothesis, key: int) -> Array:
    """Return the places [N 3] at frame 0 of the points of a key frame."""
    state, points = hypothesis.state, hypothesis.points
    mine = points.frame == key
    back = inverse(state.motions(len(state.angle))[key, points.label[mine]])
    here = points.ray[mine] / points.inverse_depth[mine, None]
    return np.einsum("nab,nb->na", back[:, :3, :3], here) + back[:, :3, 3]


def center_depths(hypothesis: VideoHypothesis) -> VideoHypothesis:
    """Return the same motion in that unit of length in which the median inverse depth is 1, as the
    priors expect; the images do not change."""
    state, points = hypothesis.state, hypothesis.points
    scale = float(np.median(points.inverse_depth))
    state = replace(state, twist=scale_twists(state.twist, state.prismatic, scale),
                    angle=state.angle * np.where(state.prismatic, scale, 1.0))
    return replace(hypothesis, state=state,
                   points=replace(points, inverse_depth=points.inverse_depth / scale))


def jerk_of(state: Articulation) -> float:
    """Return the root mean square of the second differences of the displacements."""
    jerk = np.diff(state.angle, 2, axis=0)
    return float(np.sqrt(np.mean(jerk**2))) if len(jerk) else 0.0


class RgbEvidence:
    """A plain video (see `estimator.Evidence`)."""

    def __init__(
        self, video: VideoEvidence, priors: JointPriors, settings: RgbSettings,
        axis_by_edges: DoorAxis | None = None, box: BoxDirections | None = None,
    ) -> None:
        self.video, self.priors = video, priors
        self.settings, self.chain = settings, settings.chain
        self.axis_by_edges, self.box = axis_by_edges, box
        self.solver = Solver(settings.damping, 1e-6, max_step=settings.max_step, scaled=True)
        self.joints = len(priors.prismatic)
        self._samples: dict[tuple[tuple[int, ...], int, OutlineKind], SampledPixels] = {}
        self._ranks: dict[tuple[SampledPixels, tuple[float, ...]], Array] = {}

    @property
    def unit_is_free(self) -> bool:
        """Whether known axes do not tell how far away the points are."""
        return self.priors.line is not None and self.video.distance is None

    @property
    def final_keys(self) -> tuple[int, ...]:
        """The key frames of refinements."""
        return tuple(range(0, self.video.frames, self.settings.final_key_frame_step))

    @cached_property
    def _flow_records(self) -> Image:
        return flow_records(self.video)

    @cached_property
    def edge_planes(self) -> EdgePlanes:
        """The planes of the straight edges of what moves."""
        return planes_of_moving_edges(self.video, self.settings)

    @property
    def may_be_door(self) -> bool:
        """Whether one part turns, depth is not measured, and straight edges may count."""
        return bool(self.joints == 1 and not self.priors.prismatic[0]
                    and self.video.distance is None and self.settings.edge_weight)

    @property
    def may_be_slide(self) -> bool:
        """Whether one part slides whose depth is not measured."""
        return bool(self.joints == 1 and self.priors.prismatic[0] and self.video.distance is None)

    def with_axis_by_edges(self) -> RgbEvidence:
        """Return the evidence of a door whose axis has an unknown direction with that which its
        straight edges show; itself elsewhere, and where they do not show it."""
        if self.priors.axis_dof != 4 or not self.may_be_door:
            return self
        still = planes_of_still_edges(self.video, self.settings)
        axis = find_axis(self.edge_planes, still, self.settings)
        if axis is None:
            return self
        known = replace(self.priors, direction=axis.direction[None])
        return RgbEvidence(self.video, known, self.settings, axis)

    def along_box(self, direction: Array) -> list[RgbEvidence]:
        """Return the evidence of a slide whose direction is not known with each of the three
        directions that straight edges show, the nearest to `direction` [3] first; none elsewhere,
        and where they do not show them."""
        if not self.may_be_slide or self.priors.direction is not None:
            return []
        still = planes_of_still_edges(self.video, self.settings)
        box = find_box_directions(self.edge_planes, still, self.settings)
        return [] if box is None else [
            RgbEvidence(self.video, replace(self.priors, direction=axis[None]), self.settings,
                        box=box) for axis in box.nearest_first(direction)]

    @cached_property
    def edges(self) -> DoorEdges | None:
        """The straight edges of a door whose depth is not measured and whose axis has a known
        direction; None elsewhere, and where they are not across the axis."""
        axis = self.priors.direction
        if axis is None or not self.may_be_door:
            return None
        return see_edges(self.edge_planes, axis[0], self.settings)

    def by_each_flow(self) -> list[RgbEvidence]:
        """Return this evidence, and that by the second flow of the video."""
        second = self.video.second
        return [self] if second is None else [
            self, RgbEvidence(second, self.priors, self.settings)]

    def sample(
        self, frames: tuple[int, ...], most: int, outline: OutlineKind = "none"
    ) -> SampledPixels:
        """Return about `most` pixels of each key frame, and some on the outline if asked for; the
        same object in each call."""
        asked = frames, most, outline
        if asked not in self._samples:  # two threads may sample: both get the first
            self._samples.setdefault(
                asked, sample_pixels(self.video, frames, most, self.settings, outline))
        return self._samples[asked]

    def label(self, hypothesis: VideoHypothesis, points: SampledPixels) -> VideoHypothesis:
        """Label pixels, which need not be the hypothesis' own (E-step)."""
        own = hypothesis.points.ray is points.ray
        keys, key = np.unique(points.frame, return_inverse=True)
        k = self.video.intrinsics
        rays = MovedRays(
            points.ray, key, motions_from_frames(hypothesis.state, keys),
            (float(k[0, 0]), float(k[0, 2]), float(k[1, 2])))
        depth = hypothesis.points.inverse_depth if own else points.expected
        depth = np.repeat(depth[:, None], self.joints, axis=1)
        by_flow = np.zeros_like(depth)
        for iterations in self.settings.depth_rounds:
            by_flow, depth = flow_costs(
                rays, points.expected, depth, self._flow_records, iterations, self.settings)
            if iterations:
                depth = points.average(depth)
        by_flow[points.outline.on] = 0.0  # there, flow is a mixture: neighbors label these pixels
        cost, measured = by_flow, hypothesis.points
        if self.joints == 1 and measured.place_information.any():
            # no label can change, so that the depths of bundle adjustment stay: they are better
            depth = interpolate_depths(measured, points.frame, points.ray, depth[:, 0])[:, None]
        if own and measured.place_information.any():
            cost = cost + self.settings.patch_label_weight * patch_costs(
                rays, depth, measured.place, measured.place_information, self.settings)
        rank = self.rank(points, hypothesis.base)
        parts = np.tile(np.arange(1, self.joints + 1), (len(key), 1))
        place = project_rays(  # in each key frame on each part
            rays.motion.take(keys, axis=1), key, parts, points.ray, depth, k)
        tracks = average_along_tracks(points, cost, place)
        label = assign_labels(points, tracks, rank, self.settings.order_cost)
        if points.part is not None:
            label = points.part - 1
        mine = np.arange(len(label)), label
        labeled = replace(
            hypothesis.points, frame=points.frame, ray=points.ray, label=label + 1,
            inverse_depth=depth[mine], expected=points.expected, outline=points.outline,
            neighbors=points.neighbors)
        s, out = self.settings, replace(hypothesis, points=labeled, cost=float(cost[mine].mean()))
        penalty = (s.score_flow * float(by_flow[mine].mean())
                   + s.score_inversions * label_inversions(label, rank, points.frame)
                   + s.score_offset * self.axis_offset(out))
        out = replace(out, penalty=penalty)
        return center_depths(out) if self.unit_is_free else out

    def axis_offset(self, hypothesis: VideoHypothesis) -> float:
        """Return the number of axes far from their hinges, of joints that a part carries.

        An axis counts 1/2 at the distance `settings.axis_offset`, and 1 at most.
        """
        carried = (self.priors.parent >= 0) & ~self.priors.prismatic
        away = offset_from_axis(hypothesis.state.twist, self.hinges(hypothesis).point)[carried]
        square = (away**2).sum(axis=1)
        return float((square / (square + self.settings.axis_offset**2)).sum())

    def rank(self, points: SampledPixels, base: Array) -> Array:
        """Return the rank [N] of each point in its key frame, 0..1 from the base outward."""
        name = (points, tuple(base.tolist()))
        if name not in self._ranks:
            out = np.zeros(len(points.frame))
            for f in np.unique(points.frame):
                mine = points.frame == f
                out[mine] = geodesic_rank(
                    points.ray[mine], base[None] / base[2], self.video.settings)
            self._ranks[name] = out
        return self._ranks[name]

    def hinges(self, hypothesis: VideoHypothesis) -> HingePrior:
        """Return where the parts of the first key frame meet."""
        points, first = hypothesis.points, int(hypothesis.points.frame.min())
        meet = locate_hinges(
            places_at_start(hypothesis, first), points.label[points.frame == first],
            hypothesis.base, self.priors.parent, self.settings.chain)
        return HingePrior(meet, self.settings.hinge_slack, meet)

    def measure(self, hypothesis: VideoHypothesis, how: VideoAdjustment) -> RayResiduals:
        """Measure the points of a hypothesis by flow, or by patches, which do not drift, and by
        tracks where these are more certain."""
        s, state, points = self.settings, hypothesis.state, hypothesis.points
        if how.patches is None:
            points = measure_flow(self.video, state, points, s)
        else:
            points = measure_patches(self.video, state, points, *how.patches, s)
            if s.drop_at_rest:
                on_base = np.append(False, self.priors.parent < 0)[points.label]
                points = drop_points_at_rest(state, points, self.video.intrinsics, on_base, s)
            points = add_tracks(self.video, points, s)
        return RayResiduals(points, self.video.intrinsics, how.depth_sigma,
                            smoothness_blocks(points, s), s, self.edges)

    def refine_by_patches(
        self, hypothesis: VideoHypothesis, points: SampledPixels, rounds: int, reach: float
    ) -> VideoHypothesis:
        """EM with patches and tracks. The cost becomes their misfit, with a penalty for jerky
        motion."""
        s = self.settings
        span = s.outline_span if points.outline.is_round else s.patch_span
        adjustments = self.adjustments_by_patches(rounds, reach, span)
        hypothesis = run_em(self, hypothesis, [((how,), points) for how in adjustments])
        return self.with_misfit(hypothesis, span)

    def adjustments_by_patches(
        self, rounds: int, reach: float, span: int
    ) -> list[VideoAdjustment]:
        """Return the adjustments of rounds of EM by patches, the first with another search radius,
        px, the others over `span` frames."""
        s = self.settings
        other = VideoAdjustment(s.final_scales, depth_sigma=s.depth_sigma_bundle,
                                patches=(s.patch_reach, span))
        first = replace(other, scales=s.refine_scales, patches=(reach, s.patch_span_first))
        return [first, *[other] * (rounds - 1)]

    def with_misfit(self, hypothesis: VideoHypothesis, span: int) -> VideoHypothesis:
        """Return a hypothesis whose cost is the misfit of its patches and tracks, with a penalty
        for jerky motion."""
        s, state = self.settings, hypothesis.state
        fit = patch_misfit(self.video, state, hypothesis.points, span, s)
        fit += s.score_tracks * track_misfit(self.video, state, hypothesis.points, s)
        missed = self.edges.misfit(state.angle[:, 0], s) if self.edges else 0.0
        return replace(hypothesis, cost=fit + s.score_jerk * jerk_of(state),
                       penalty=hypothesis.penalty + s.score_edges * missed)

    def tracking_round(self, points: SampledPixels) -> VideoRound:
        """Return a round of EM with patches on the frames so far, with stronger priors: these
        frames are few."""
        s = self.settings
        other = VideoAdjustment(
            s.tracking_scales, prior=s.tracking_prior, depth_sigma=s.depth_sigma_tracking,
            patches=(s.patch_reach, s.patch_span))
        first = replace(other, scales=s.tracking_scales_first,
                        patches=(s.patch_reach_new, s.patch_span))
        return (first, other), points

    def track(self, hypothesis: VideoHypothesis, until: int) -> VideoHypothesis:
        """Refine a hypothesis, and extend it to frame `until` by patches: flow shows too little
        motion on plain surfaces."""
        def rounds_of(extended: VideoHypothesis) -> list[VideoRound]:
            keys = tuple(range(0, len(extended.state.angle), self.settings.key_frame_step))
            points = self.sample(keys, self.settings.tracking_points)
            known = extended.points.ray is points.ray
            return [*([] if known else [((), points)]), self.tracking_round(points)]

        hypothesis = run_em(self, hypothesis, rounds_of(hypothesis))
        return track(self, hypothesis, until, rounds_of, PACE_STEPS)


def refine_points(
    evidence: RgbEvidence, points: SampledPixels, rounds: int, reach: float
) -> Callable[[VideoHypothesis], VideoHypothesis]:
    """Return how a hypothesis is refined by patches of some points."""
    return lambda h: evidence.refine_by_patches(h, points, rounds, reach)
