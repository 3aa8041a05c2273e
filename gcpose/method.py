"""GC-Pose: the stages of the paper in order (Fig. 2), with depth or on plain video."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from ..errors import ConfigError, MethodError
from ..renderer.types import Estimate, Inputs, Knowledge, Observation
from ..robots.geometry import Array
from .chain import JointPriors, joint_priors, screws_of
from .fusion import estimate_by_fusion
from .images import (
    Flow,
    FlowPair,
    FrontEnd,
    VideoEvidence,
    dis_flow,
    find_depth,
    find_flow,
    find_foreground,
    row_suffix,
    to_still_video,
    training_of,
    video_evidence,
)
from .input_checks import check_observation
from .rgb import RgbEvidence, estimate_rgb, find_focal_length, has_square_pixels, see_video
from .rgbd import depth_video, estimate_rgbd, is_static
from .settings import Settings

_DEFAULT = Settings()
_RELIABLE_TURN, _RELIABLE_SLIDE = np.radians(10.0) / 3, 0.1 / 3
"""Largest standard deviation of a reliable joint, rad and m: a third of the error that
`Estimate.reliable` promises in 95 % of the cases, since the errors have heavy tails."""


def two_flows_pay(observation: Observation, priors: JointPriors) -> bool:
    """Return whether an object is searched by two flows by default: on plain video, where it has
    several joints, of whose axes the directions alone are known."""
    return (observation.depth is None and len(priors.prismatic) > 1 and priors.line is None
            and priors.direction is not None)


def fusion_pays(observation: Observation, priors: JointPriors) -> bool:
    """Return whether noisy depth and images are adjusted to at once: where nothing is known of the
    axes of several joints."""
    return observation.depth_noise > 0 and len(priors.prismatic) > 1 and priors.axis_dof == 4


class GCPose:
    """Articulated motion from a video by geometric constraints alone."""

    name = "gcpose"
    inputs: tuple[Inputs, ...] = ("rgb", "rgbd", "rgbd-noise")
    knowledge: tuple[Knowledge, ...] = ("free", "axes", "kinematics")
    version = "43"
    authors = "the gcbench authors, after Q. Liu et al."
    link = "https://arxiv.org/abs/2012.00088"

    def __init__(
        self, flow: Flow | str = "", depth: str = "", foreground: str = "",
        settings: Settings = _DEFAULT,
    ) -> None:
        """Make a method with an optical flow, a depth network, a foreground, and settings.

        Args:
            flow: A flow, or the name of one (images/flow.py); default: OpenCV's DIS, and on plain
                video of several joints at `axes` the network `raft` as well.
            depth: Name of a network for depth from single images (images/depth.py).
            foreground: Name of what finds the moving pixels of plain video (images/foreground.py);
                default: the network whose weights come with gcbench.
            settings: The tuned numbers. The method's name lists those that are changed.

        Raises:
            GcbenchError: If a name is unknown or a file is missing.
        """
        self.settings = settings
        of = settings.images.flow
        named = (find_flow(flow, of) if flow else None) if isinstance(flow, str) else flow
        self.flow: Flow = named or dis_flow
        self._flow_is_named = named is not None
        used = named or find_flow("dis-fine+raft", of)
        one, two = (used.one, used.two) if isinstance(used, FlowPair) else (used, None)
        self.front_end = FrontEnd(
            one,
            find_foreground(foreground or "network", settings.images),
            find_depth(depth) if depth else None,
            bidirectional=settings.rgb.track_share > 0, averages_depth=True,
            second_flow=two)
        """On images."""
        self.name += row_suffix(flow=flow if isinstance(flow, str) else "", depth=depth,
                                foreground=foreground)
        self.name += "".join(f" {k}={v}" for k, v in settings.changes().items())
        end = self.front_end
        self.training = training_of(
            self.flow, end.foreground, end.depth,
            then="" if self._flow_is_named else f"{training_of(end.second_flow)}, for rgb")

    def estimate(self, observation: Observation, object_depth: float | None = None) -> Estimate:
        """Estimate the motion of one sequence (Sec. 3.2 to 3.4); zero where nothing moves.

        With depth, the camera must stand still, and depth must be aligned with the images and taken
        at the same time: this is not checked, and a wrong motion may be called reliable.

        Plain video has no unit of length, which joints that slide need. Known lines of axes give
        it; so does `object_depth`: the depth (z in the camera frame) of what moves in frame 0, m.

        Raises:
            ConfigError: If `object_depth` is not a positive length.
            MethodError: If the video cannot be used, too little of what moves is seen, or the
                observation does not fit together.
        """
        if object_depth is not None and not (
                np.issubdtype(type(object_depth), np.number) and 0 < object_depth < np.inf):
            raise ConfigError(f"object_depth={object_depth}: give a positive length, m")
        with threadpool_limits(1, "blas"):  # on small matrices its threads only wait
            try:
                return self._estimate(check_observation(observation), object_depth)
            except np.linalg.LinAlgError as error:
                raise MethodError("gcpose sees too little of what moves to estimate it "
                                  f"({error}); use larger images") from error

    def find_focal_length(self, observation: Observation) -> float | None:
        """Return the focal length of the camera of a plain video of a door or a drawer, px, by its
        straight edges; None where they do not tell it. The focal length of the observation is where
        the search begins."""
        video = self._video(observation)
        slides = "prismatic" in observation.joint_types
        return None if video is None else find_focal_length(video, self.settings.rgb, slides)

    def find_axis(self, observation: Observation) -> Array | None:
        """Return the direction [3] of the axis of a door on plain video, in the camera's frame, by
        the straight edges of the door; None where they do not tell it. A direction that the
        observation names is not used."""
        video = self._video(observation)
        if video is None:
            return None
        unknown = replace(joint_priors(observation), direction=None, line=None)
        axis = RgbEvidence(video, unknown, self.settings.rgb).with_axis_by_edges().axis_by_edges
        return None if axis is None else axis.direction

    def sees_motion(self, observation: Observation) -> bool:
        """Return whether anything is seen to move on plain video."""
        return self._video(observation) is not None

    def finds_shadows(self, observation: Observation) -> bool:
        """Return whether texture that stays where it is, under a shadow, is left out of one part
        that turns on plain video. Its turn is not reliable then."""
        video = self._video(observation)
        return video is not None and video.has_shadows

    def _video(self, observation: Observation) -> VideoEvidence | None:
        """What moves in images alone; None if nothing does."""
        if observation.rgb is None:
            return None
        still = to_still_video(check_observation(observation), self.settings.images)
        end = replace(self._front_end_of(still.homography is not None), second_flow=None)
        return video_evidence(
            replace(still.observation, depth=None), end, self.settings.images)

    def _front_end_of(self, aligned: bool) -> FrontEnd:
        """What sees a video. Frames that are aligned are less exact, so that all texture counts."""
        return replace(self.front_end, drops_still_texture=not aligned)

    def _estimate(self, observation: Observation, object_depth: float | None) -> Estimate:
        still = to_still_video(observation, self.settings.images)
        observation = still.observation
        priors = joint_priors(observation)
        if observation.depth is None:
            found = self._estimate_by_images(
                observation, priors, self._front_end_of(still.homography is not None),
                object_depth)
        else:
            found = self._estimate_by_depth(observation, priors)
        if (found is None or found.sigma is None
                or not np.isfinite([found.displacement, found.sigma]).all()):
            found = self._static(observation, priors)
        found = self._doubt_rest(found, priors)
        limit = np.where(priors.prismatic, _RELIABLE_SLIDE, _RELIABLE_TURN)
        reliable = None if found.sigma is None else found.sigma[-1] <= limit
        return still.move_back(replace(found, reliable=reliable))

    def _estimate_by_images(
        self, observation: Observation, priors: JointPriors, end: FrontEnd,
        object_depth: float | None = None,
    ) -> Estimate | None:
        settings, end = self.settings, self._used_flows(observation, priors, end)
        return estimate_rgb(
            observation, priors, end, settings.rgb, settings.images, object_depth)

    def _used_flows(
        self, observation: Observation, priors: JointPriors, end: FrontEnd
    ) -> FrontEnd:
        """The flow that was named; else two where this was found to pay."""
        pays = self._flow_is_named or two_flows_pay(observation, priors)
        return end if pays else replace(end, second_flow=None)

    def _estimate_by_depth(
        self, observation: Observation, priors: JointPriors
    ) -> Estimate | None:
        """By depth; with noisy depth, by images and depth as a prior where the object is too small
        for its noise, or by both where this was found to pay."""
        settings, end = self.settings, self.front_end
        video = depth_video(observation, self.flow, settings.rgbd, settings.images)
        if video is None:
            return None
        square = has_square_pixels(observation.intrinsics)
        share = video.noise_share(observation.n_joints, settings.rgbd.chain)
        if square and share > settings.rgbd.max_noise_share:
            return self._estimate_by_images(observation, priors, end)
        if square and fusion_pays(observation, priors):
            end = self._used_flows(observation, priors, end)
            seen = see_video(observation, priors, end, settings.rgb, settings.images)
            if seen is not None:
                return estimate_by_fusion(
                    video, seen, priors, self.flow, settings.fusion, settings.rgbd)
        return estimate_rgbd(video, priors, self.flow, settings.rgbd)

    def _doubt_rest(self, found: Estimate, priors: JointPriors) -> Estimate:
        """Return an estimate with larger deviations if a joint of several hardly moves and no axis
        is known: one motion does not tell which of two joints makes it."""
        of, several = self.settings.rgbd, len(priors.prismatic) > 1 and priors.axis_dof == 4
        if found.sigma is None or not (
                several and is_static(found.displacement, priors.prismatic, of).any()):
            return found
        sigma = np.maximum(found.sigma, of.sigma_unreliable)
        sigma[0] = 0.0
        return replace(found, sigma=sigma)

    def _static(self, observation: Observation, priors: JointPriors) -> Estimate:
        """Return zero displacements with a large standard deviation."""
        frames, joints = len(observation.times), observation.n_joints
        images = observation.rgb if observation.depth is None else observation.depth
        sigma = np.full((frames, joints), self.settings.rgbd.sigma_static)
        sigma[0] = 0.0
        screw = None if priors.line is None else screws_of(priors.line, priors.prismatic)
        part = None if images is None else np.zeros(images.shape[:3], np.uint8)
        return Estimate(np.zeros((frames, joints)), screw, part, sigma)
