"""The paper's pipeline as it is written, in the steps of its ablation (Table 3).

`gcpose-flow`: parts by EM on the flow between two frames, an essential matrix for each, and the sum
of the angles that explain their rotations. `gcpose-epipolar`: with a flow network that is tuned to
the video. `gcpose-depth`: with depth, motions by PnP and bundle adjustment over all frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import MethodError
from ...renderer.types import Estimate, Inputs, Knowledge, Observation
from ...robots.geometry import Array
from ...robots.motion import ChainAxes
from ..chain import Articulation, axis_twists, joint_priors, locate_hinges
from ..estimator import adjust
from ..images import (
    Depth,
    Flow,
    FrontEnd,
    find_depth,
    find_flow,
    for_cuts_of,
    row_suffix,
    subtract_background,
    to_still_video,
    training_of,
    video_evidence,
)
from ..numerics import Image
from ..rgb import (
    InverseDepthPoints,
    RgbEvidence,
    SampledPixels,
    VideoAdjustment,
    VideoHypothesis,
    base_candidates,
)
from .epipolar import (
    MatchedParts,
    PartMatcher,
    accumulate_angles,
    joint_orders,
    rotations,
    rotations_with_depth,
)
from .settings import PublishedSettings

_DEFAULT = PublishedSettings()
PAPER = ("Q. Liu, W. Qiu, W. Wang, G. D. Hager, A. L. Yuille",
         "https://arxiv.org/abs/2012.00088", "2020-11")
"""Authors, link and date of the paper."""
_TUNED = "self-supervised on the video"


class FlowOnly:
    """Sec. 3.2 and 3.3 with a flow as it is."""

    name = "gcpose-flow"
    inputs: tuple[Inputs, ...] = ("rgb",)
    knowledge: tuple[Knowledge, ...] = ("axes",)
    version = "5"
    authors, link, date = PAPER

    def __init__(self, flow: str = "", settings: PublishedSettings = _DEFAULT) -> None:
        """Make the method with a flow by name (see `find_flow`); default: OpenCV's DIS.

        Raises:
            GcbenchError: If the name is unknown or a file is missing.
        """
        self.flow: Flow = find_flow(flow or "dis-fine", settings.images.flow)
        self.settings, self.training = settings, training_of(self.flow)
        self.name += _suffix(settings, flow=flow)

    def estimate(self, observation: Observation) -> Estimate:
        """Return the angles, summed over consecutive frames.

        Raises:
            MethodError: If a joint slides: without scale its step is unknown.
        """
        video = _observe(observation, self.name, self.flow, self.settings)
        return _estimate(observation, video, _angles_by_flow)


class Epipolar:
    """The same with a flow network that is tuned to the video by the epipolar constraint.

    Default: the network whose weights come with gcbench. It takes a little over a minute of a core
    for a sequence.
    """

    name = "gcpose-epipolar"
    inputs: tuple[Inputs, ...] = ("rgb",)
    knowledge: tuple[Knowledge, ...] = ("axes",)
    version = "7"
    authors, link, date = PAPER

    def __init__(self, flow: str = "", settings: PublishedSettings = _DEFAULT) -> None:
        """Make the method with a flow network: "raft:WEIGHTS", "flownet2:CHECKPOINT", ...

        Raises:
            GcbenchError: If the flow is no network, a file is missing, or PyTorch is.
        """
        self.name += _suffix(settings, flow=flow)
        self.settings, self.network = settings, _network(flow, settings)
        self.training = training_of(self.network, then=_TUNED)

    def estimate(self, observation: Observation) -> Estimate:
        """Return the angles, summed over consecutive frames.

        Raises:
            MethodError: If a joint slides: without scale its step is unknown.
        """
        video = _observe(observation, self.name, self.network, self.settings)
        return _estimate(observation, _tune(video, self.network), _angles_by_flow)


class WithDepth:
    """The same with depth: measured, or a network's."""

    name = "gcpose-depth"
    inputs: tuple[Inputs, ...] = ("rgb", "rgbd", "rgbd-noise")
    knowledge: tuple[Knowledge, ...] = ("axes",)
    version = "8"
    authors, link, date = PAPER

    def __init__(
        self, flow: str = "", depth: str = "", settings: PublishedSettings = _DEFAULT
    ) -> None:
        """Make the method with a flow network and a depth network (see `find_depth`).

        Without a depth network it does not support the inputs `rgb`.

        Raises:
            GcbenchError: If the flow is no network, a file is missing, or PyTorch is.
        """
        self.name += _suffix(settings, flow=flow, depth=depth)
        self.settings, self.network = settings, _network(flow, settings)
        self.depth = find_depth(depth) if depth else None
        self.training = training_of(self.depth, self.network, then=_TUNED)
        if self.depth is None:
            self.inputs = ("rgbd", "rgbd-noise")
            self.hint = "with --depth mono:FOLDER or hf:MODEL (a depth network) rgb, too"

    def estimate(self, observation: Observation) -> Estimate:
        """Return the angles after bundle adjustment over all frames (Sec. 3.4).

        Raises:
            MethodError: If a joint slides, or there is no depth.
        """
        if self.depth is None and observation.depth is None:
            raise MethodError(f"{self.name} needs depth: a network (--depth mono:FOLDER or "
                              "hf:MODEL), or --inputs rgbd")
        video = _observe(observation, self.name, self.network, self.settings, self.depth)
        return _estimate(observation, _tune(video, self.network), _angles_by_depth)


def _suffix(settings: PublishedSettings, **options: str) -> str:
    """What options and changed settings add to a method's name."""
    return row_suffix(**options) + "".join(f" {k}={v}" for k, v in settings.changes().items())


def _network(flow: str, settings: PublishedSettings) -> Any:
    """The flow network of a name; it needs PyTorch."""
    from ..images.network_flow import find_network_flow

    paper, of = settings.paper, settings.images.flow
    if not flow:
        of = replace(of, raft_iterations=paper.tuning_iterations, raft_side=paper.tuning_side)
    return find_network_flow(flow or "raft", of)


# -- the stages -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Video:
    """A sequence and its sampled pixels."""

    observation: Observation
    evidence: RgbEvidence
    points: list[SampledPixels]
    """Of each frame"""
    bases: list[Array]
    """[3] of each frame, at depth 1"""
    settings: PublishedSettings

    def match(self, k: int, flow: Image) -> MatchedParts | None:
        """Parts between frame k and the next."""
        matcher = PartMatcher(float(self.evidence.video.intrinsics[0, 0]), self.evidence.joints,
                              self.settings.paper, self.settings.images)
        return matcher.match(self.points[k], self.bases[k], flow)

    def match_all(self) -> list[MatchedParts | None]:
        """The same for all frames, by the flow of the video."""
        return [self.match(k, flow) for k, flow in enumerate(self.evidence.video.flow)]


def _observe(
    observation: Observation, name: str, flow: Flow, settings: PublishedSettings,
    depth: Depth | None = None,
) -> _Video | None:
    """Measure the images and sample pixels; None where nothing moves or axes are unknown."""
    known = joint_priors(observation)
    if known.prismatic.any():
        j = int(np.flatnonzero(known.prismatic)[0]) + 1
        raise MethodError(f"{name} measures turns, and joint {j} slides; use gcpose")
    observation = to_still_video(observation, settings.images).observation
    by_color = partial(subtract_background, settings=settings.images)
    measured = video_evidence(observation, FrontEnd(flow, by_color, depth), settings.images)
    if measured is None or known.direction is None:
        return None
    evidence = RgbEvidence(measured, known, settings.rgb)
    points = [evidence.sample((k,), settings.paper.max_points) for k in range(measured.frames)]
    bases = [base_candidates(evidence, p, k)[0] if len(p.frame) else np.zeros(3)
             for k, p in enumerate(points)]
    return _Video(observation, evidence, points, bases, settings)


def _tune(video: _Video | None, network: Any) -> _Video | None:
    """Replace the flow by the tuned network's, unless it is an oracle's."""
    from .fine_tune import tune_flow

    if video is None or video.observation.rgb is None or video.observation.flow is not None:
        return video
    rgb, measured = video.observation.rgb, video.evidence.video
    height, width = measured.moving.shape[1:]
    left, top = measured.corner
    crop = np.ascontiguousarray(rgb[:, top : top + height, left : left + width])
    sized: Any = for_cuts_of(network, *rgb.shape[1:3])
    flow = tune_flow(
        sized, crop, measured.moving,
        float(measured.intrinsics[0, 0]), video.match, video.settings.paper)
    evidence = RgbEvidence(replace(measured, flow=flow), video.evidence.priors, video.settings.rgb)
    return replace(video, evidence=evidence)


def _accumulate(
    video: _Video, pairs: list[MatchedParts | None], steps: Sequence[Sequence[Array | None]]
) -> tuple[Array, list[NDArray[np.int64]]]:
    """Displacements [T J], and the joints [J] of each pair's parts."""
    known, paper = video.evidence.priors, video.settings.paper
    assert known.direction is not None
    joints = video.evidence.joints
    given = video.observation.part is not None  # parts of an oracle are in order
    orders = [np.arange(joints)] if given else joint_orders(joints, paper.max_left_out)
    axes = ChainAxes(known.direction, known.prismatic, known.parent)
    return accumulate_angles(pairs, steps, axes, orders, paper)


def _angles_by_flow(video: _Video) -> Array:
    """Displacements [T J] by essential matrices (Sec. 3.3)."""
    pairs, none = video.match_all(), [None] * video.evidence.joints
    steps = [none if p is None else rotations(p, video.settings.paper) for p in pairs]
    return _accumulate(video, pairs, steps)[0]


def _angles_by_depth(video: _Video) -> Array:
    """Displacements [T J] by PnP, then bundle adjustment of all points (Sec. 3.4)."""
    evidence, paper = video.evidence, video.settings.paper
    focal = float(evidence.video.intrinsics[0, 0])
    pairs, none = video.match_all(), [None] * evidence.joints
    steps = [none if p is None else rotations_with_depth(p, q.expected, focal, paper)
             for p, q in zip(pairs, video.points[:-1], strict=True)]
    angle, joint = _accumulate(video, pairs, steps)
    keys = [k for k, p in enumerate(pairs) if p is not None]
    if not keys or keys[0]:
        return angle
    label = np.concatenate([joint[k][p.label - 1] + 1 for k, p in enumerate(pairs)
                            if p is not None])
    hypothesis = _hypothesis(video, angle, keys, label)
    sigma, depth = paper.estimated_depth_sigma, video.observation.depth
    if depth is not None:
        noise = video.observation.depth_noise / max(1e-6, np.median(depth[depth > 0]))
        sigma = float(np.hypot(paper.measured_depth_sigma, noise))
    for scale in paper.bundle_scales:
        how = VideoAdjustment((scale,), depth_sigma=sigma)  # measures the flow anew
        hypothesis = adjust(evidence, hypothesis, how)
    return hypothesis.state.angle


def _hypothesis(
    video: _Video, angle: Array, keys: list[int], label: NDArray[np.int64]
) -> VideoHypothesis:
    """Displacements [T J] and labeled points [N] of key frames, with axes at the first hinges."""
    evidence, known, first = video.evidence, video.evidence.priors, video.points[0]
    assert known.direction is not None
    cloud = evidence.sample(tuple(keys), video.settings.paper.max_points)
    at = locate_hinges(first.ray / first.expected[:, None], label[: len(first.frame)],
                       video.bases[0],
                known.parent, evidence.chain)
    twist = np.concatenate([axis_twists(known, j, direction[None], at[j : j + 1])
                            for j, direction in enumerate(known.direction)])
    mine = label > 0
    points = InverseDepthPoints.without_measurements(
        cloud.frame[mine], cloud.ray[mine], label[mine], cloud.expected[mine])
    state = Articulation(twist, angle, known.prismatic, known.parent)
    return VideoHypothesis(state, points, video.bases[0], np.inf)


def _estimate(
    observation: Observation, video: _Video | None, angles: Callable[[_Video], Array]
) -> Estimate:
    """The estimate; no motion where nothing was seen, or a number is not finite."""
    still = np.zeros((len(observation.times), observation.n_joints))
    angle = still if video is None else angles(video)
    return Estimate(angle if np.isfinite(angle).all() else still)
