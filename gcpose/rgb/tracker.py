"""EM over a video without depth (Sec. 3.2 to 3.4): labels and motion by flow and by patches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...robots.geometry import Array, inverse
from ..chain import HingePrior, JointPriors, locate_hinges, offset_from_axis
from ..estimator import Hypothesis
from ..images import VideoEvidence, geodesic_rank
from .bundle import BundleSetup, BundleWeights, adjust_points
from .costs import MovedRays, flow_costs, patch_costs
from .labels import (
    SampledPixels,
    assign_labels,
    average_along_tracks,
    label_inversions,
    sample_pixels,
)
from .points import (
    InverseDepthPoints,
    add_tracks,
    measure_flow,
    measure_patches,
    motions_from_frames,
    patch_misfit,
    project_rays,
    track_misfit,
)
from .settings import RgbSettings

VideoHypothesis = Hypothesis[InverseDepthPoints]


def places_at_start(hypothesis: VideoHypothesis, key: int) -> Array:
    """Return the places [N 3] at frame 0 of the points of a key frame."""
    state, points = hypothesis.state, hypothesis.points
    mine = points.frame == key
    back = inverse(state.motions(len(state.angle))[key, points.label[mine]])
    here = points.ray[mine] / points.inverse_depth[mine, None]
    return np.einsum("nab,nb->na", back[:, :3, :3], here) + back[:, :3, 3]


class VideoTracker:
    """EM steps of hypotheses on one video."""

    def __init__(self, evidence: VideoEvidence, known: JointPriors, settings: RgbSettings) -> None:
        self.evidence, self.known, self.settings = evidence, known, settings
        self.joints = len(known.prismatic)
        self._samples: dict[tuple[tuple[int, ...], int], SampledPixels] = {}
        self._ranks: dict[tuple[SampledPixels, tuple[float, ...]], Array] = {}

    def sample(self, frames: tuple[int, ...], most: int) -> SampledPixels:
        """Return about `most` pixels of each key frame, the same object in each call."""
        if (frames, most) not in self._samples:  # two threads may sample: both get the first
            self._samples.setdefault(
                (frames, most), sample_pixels(self.evidence, frames, most, self.settings))
        return self._samples[frames, most]

    def relabel(self, hypothesis: VideoHypothesis, points: SampledPixels) -> VideoHypothesis:
        """E-step: label `points`, which need not be the hypothesis' own."""
        own = hypothesis.points.ray is points.ray
        keys, key = np.unique(points.frame, return_inverse=True)
        k = self.evidence.intrinsics
        rays = MovedRays(
            points.ray, key, motions_from_frames(hypothesis.state, keys),
            (float(k[0, 0]), float(k[0, 2]), float(k[1, 2])))
        depth = hypothesis.points.inverse_depth if own else points.expected
        depth = np.repeat(depth[:, None], self.joints, axis=1)
        by_flow = np.zeros_like(depth)
        for iterations in self.settings.depth_rounds:
            by_flow, depth = flow_costs(rays, depth, self.evidence, iterations, self.settings)
            if iterations:
                depth = points.average(depth)
        cost = by_flow
        measured = hypothesis.points
        if own and measured.place_information.any():
            cost = cost + self.settings.patch_label_weight * patch_costs(
                rays, depth, measured.place, measured.place_information, self.settings)
        rank = self.rank(points, hypothesis.base)
        place = project_rays(  # in each key frame on each part
            rays.motion[key][:, keys, 1:], points.ray[:, None, None], depth[:, None], k)
        tracks = average_along_tracks(points, cost, place)
        label = assign_labels(points, tracks, rank, self.settings.order_cost)
        if points.part is not None:
            label = points.part - 1
        mine = np.arange(len(label)), label
        labeled = replace(
            hypothesis.points, frame=points.frame, ray=points.ray, label=label + 1,
            inverse_depth=depth[mine], expected=points.expected, neighbors=points.neighbors)
        s, out = self.settings, replace(
            hypothesis, points=labeled, cost=float(cost[mine].mean()))
        order = s.score_inversions * label_inversions(label, rank, points.frame)
        return replace(out, penalty=s.score_flow * float(by_flow[mine].mean()) + order
                       + s.score_offset * self.axis_offset(out))

    def axis_offset(self, hypothesis: VideoHypothesis) -> float:
        """Return the number of axes far from their hinges, of joints that a part carries.

        An axis counts 1/2 at the distance `settings.axis_offset`, and 1 at most.
        """
        carried = (self.known.parent >= 0) & ~self.known.prismatic
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
                    points.ray[mine], base[None], self.evidence.settings)
            self._ranks[name] = out
        return self._ranks[name]

    def hinges(self, hypothesis: VideoHypothesis) -> HingePrior:
        """Return where the parts of the first key frame meet."""
        points = hypothesis.points
        first = int(points.frame.min())
        meet = locate_hinges(
            places_at_start(hypothesis, first), points.label[points.frame == first],
            hypothesis.base, self.known.parent, self.settings.chain)
        return HingePrior(meet, self.settings.hinge_slack)

    def adjust(
        self, hypothesis: VideoHypothesis, points: InverseDepthPoints, weights: BundleWeights
    ) -> VideoHypothesis:
        """M-step: adjust the articulation and depths to measured points."""
        information = self.settings.patch_weight * points.place_information
        fit = adjust_points(
            hypothesis.state, replace(points, place_information=information),
            BundleSetup(self.evidence.intrinsics, self.known.axis_dof, self.hinges(hypothesis)),
            weights, self.settings)
        return replace(hypothesis, state=fit.state, equations=fit.equations,
                       points=replace(points, inverse_depth=fit.inverse_depth))

    def refine_by_flow(
        self, hypothesis: VideoHypothesis, points: SampledPixels, rounds: int,
        weights: BundleWeights,
    ) -> VideoHypothesis:
        """EM with the flow."""
        for _ in range(rounds):
            measured = measure_flow(
                self.evidence, hypothesis.state, hypothesis.points, self.settings)
            hypothesis = self.adjust(hypothesis, measured, weights)
            hypothesis = self.relabel(hypothesis, points)
        return hypothesis

    def refine_by_patches(
        self, hypothesis: VideoHypothesis, points: SampledPixels, rounds: int, reach: float
    ) -> VideoHypothesis:
        """EM with patches, which do not drift, and with tracks where these are more certain.

        The cost becomes the misfit of patches and tracks, with a penalty for jerky motion.
        """
        s = self.settings
        for i in range(rounds):
            near, span = (s.patch_reach, s.patch_span) if i else (reach, s.patch_span_first)
            scales = s.final_scales if i else s.refine_scales
            hypothesis = self._adjust_to_patches(
                hypothesis, near, span, BundleWeights(scales, s.depth_sigma_bundle))
            hypothesis = self.relabel(hypothesis, points)
        jerk = np.diff(hypothesis.state.angle, 2, axis=0)
        jerky = float(np.sqrt(np.mean(jerk**2))) if len(jerk) else 0.0
        fit = patch_misfit(self.evidence, hypothesis.state, hypothesis.points, s)
        fit += s.score_tracks * track_misfit(self.evidence, hypothesis.state, hypothesis.points, s)
        return replace(hypothesis, cost=fit + s.score_jerk * jerky)

    def _adjust_to_patches(
        self, hypothesis: VideoHypothesis, reach: float, span: int, weights: BundleWeights
    ) -> VideoHypothesis:
        points = measure_patches(self.evidence, hypothesis.state, hypothesis.points, reach, span,
                                 self.settings)
        points = add_tracks(self.evidence, points, self.settings)
        return self.adjust(hypothesis, points, weights)

    def extend(self, hypothesis: VideoHypothesis, until: int) -> VideoHypothesis:
        """Extrapolate the displacements to frame `until` at constant velocity."""
        angle = hypothesis.state.angle
        more = until + 1 - len(angle)
        if more <= 0:
            return hypothesis
        pace = (angle[-1] - angle[-min(3, len(angle))]) / (min(3, len(angle)) - 1)
        rest = angle[-1] + np.arange(1, more + 1)[:, None] * pace
        state = replace(hypothesis.state, angle=np.concatenate([angle, rest]))
        return replace(hypothesis, state=state)

    def track(self, hypothesis: VideoHypothesis, until: int) -> VideoHypothesis:
        """Track on to frame `until` by patches: flow shows too little motion on plain surfaces."""
        s = self.settings
        while True:
            now = len(hypothesis.state.angle) - 1
            points = self.sample(tuple(range(0, now + 1, s.key_frame_step)), s.tracking_points)
            if hypothesis.points.ray is not points.ray:
                hypothesis = self.relabel(hypothesis, points)
            hypothesis = self.refine_tracked(hypothesis, points)
            if now >= until:
                return hypothesis
            hypothesis = self.extend(hypothesis, now + 1)

    def refine_tracked(
        self, hypothesis: VideoHypothesis, points: SampledPixels
    ) -> VideoHypothesis:
        """EM with patches on the frames so far, with stronger priors: these frames are few."""
        s = self.settings
        rounds = ((s.patch_reach_new, s.tracking_scales_first), (s.patch_reach, s.tracking_scales))
        for reach, scales in rounds:
            hypothesis = self._adjust_to_patches(
                hypothesis, reach, s.patch_span,
                BundleWeights(scales, s.depth_sigma_tracking, s.tracking_prior))
        return self.relabel(hypothesis, points)
