"""GC-Pose: the stages of the paper in order (Fig. 2), with depth or on plain video."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..renderer.types import Estimate, Inputs, Knowledge, Observation
from ..robots.geometry import Array
from .chain import Articulation, JointPriors, joint_priors, screws_of
from .images import (
    Flow,
    depth_named,
    dis_flow,
    fine_dis_flow,
    flow_named,
    surfaces_from_depth,
    surfaces_from_noisy_depth,
    training_of,
)
from .numerics import thread_map
from .rgb import estimate_rgb
from .rgbd import (
    RgbdSettings,
    Tracker,
    Views,
    adjust,
    is_unreliable,
    moving_mask,
    search_hypotheses,
    standard_deviations,
)
from .settings import Settings

_DEFAULT = Settings()


class GCPose:
    """Articulated motion from a video by geometric constraints alone."""

    name = "gcpose"
    inputs: tuple[Inputs, ...] = ("rgb", "rgbd", "rgbd-noise")
    knowledge: tuple[Knowledge, ...] = ("free", "axes", "kinematics")
    version = "13"

    def __init__(
        self, flow: Flow | str = "", depth: str = "", settings: Settings = _DEFAULT
    ) -> None:
        """Make a method with an optical flow, a depth network, and settings.

        Args:
            flow: A flow, or the name of one (images/flow.py); default: OpenCV's DIS.
            depth: Name of a network for depth from single images (images/depth.py).
            settings: The tuned numbers. The method's name lists those that are changed.

        Raises:
            GcbenchError: If a name is unknown or a file is missing.
        """
        self.settings = settings
        named = flow_named(flow) if isinstance(flow, str) and flow else flow
        self.flow = dis_flow if isinstance(named, str) else named
        self.fine_flow = fine_dis_flow if isinstance(named, str) else named
        self.depth = depth_named(depth) if depth else None
        chosen = {"flow": flow if isinstance(flow, str) else "", "depth": depth}
        self.name += "".join(f" {k}={v.partition(':')[0]}" for k, v in chosen.items()
                             if v not in ("", "none"))
        self.name += "".join(f" {k}={v}" for k, v in settings.changes().items())
        self.training = training_of(*chosen.values())

    def estimate(self, observation: Observation) -> Estimate:
        """Estimate the motion of one sequence (Sec. 3.2 to 3.4); zero where nothing moves."""
        with threadpool_limits(1, "blas"):  # on small matrices its threads only wait
            return self._estimate(observation)

    def _estimate(self, observation: Observation) -> Estimate:
        priors = joint_priors(observation)
        rgb, settings = observation.rgb, self.settings.rgbd
        if observation.depth is None:
            found = estimate_rgb(observation, priors, self.fine_flow, self.depth, self.settings.rgb,
                                 self.settings.images)
            return found or static_estimate(observation, priors, settings.sigma_static)
        if rgb is None or len(observation.depth) < 2:
            return static_estimate(observation, priors, settings.sigma_static)
        noise = observation.depth_noise
        if noise > 0:
            surfaces = surfaces_from_noisy_depth(
                observation.depth, rgb, observation.intrinsics, noise, self.flow,
                self.settings.images)
        else:
            surfaces = surfaces_from_depth(
                observation.depth, observation.intrinsics, self.settings.images)
        mask = moving_mask(surfaces, rgb, settings.labels)
        if np.count_nonzero(mask[0]) < settings.min_moving_pixels:
            return static_estimate(observation, priors, settings.sigma_static)
        tracker = Tracker(surfaces, rgb, mask, priors, settings)
        best = search_hypotheses(tracker, self.flow)
        state, sums = adjust(
            Views(replace(surfaces, flow=None), best.clouds, tracker.hinge_prior(best)),
            best.state,
            priors.axis_dof,
            settings.final_scales_noisy if noise else settings.final_scales,
            settings,
        )
        sigma = standard_deviations(sums, *state.angle.shape)
        if not (np.isfinite(state.angle).all() and np.isfinite(sigma).all()):
            return static_estimate(observation, priors, settings.sigma_static)
        return Estimate(
            displacement=state.angle,
            screw=screws_of(state.twist, state.prismatic),
            part=label_images(tracker, state),
            sigma=calibrate_sigma(sigma, tracker, is_unreliable(tracker, best), settings),
        )


def calibrate_sigma(
    sigma: Array, tracker: Tracker, unreliable: bool, settings: RgbdSettings
) -> Array:
    """Return standard deviations [T J] that two thirds of the errors lie within.

    Errors that points share (labels, smoothing, curvature within a pixel) exceed what the
    residuals show: factor and floor are from training sequences.
    """
    s = settings
    factors = {0: s.sigma_factor_known_lines, 2: s.sigma_factor_known_directions,
               4: s.sigma_factor_free}
    factor, floor = factors[tracker.priors.axis_dof], 0.0
    if tracker.surfaces.noise:
        factor, floor = s.sigma_factor_noisy, s.sigma_floor_noisy
    if unreliable:
        floor = s.sigma_unreliable
    out = np.minimum(np.hypot(factor * sigma, floor), s.sigma_static)
    out[0] = 0.0
    return out


def static_estimate(observation: Observation, priors: JointPriors, deviation: float) -> Estimate:
    """Return the estimate where nothing is seen to move: zero with the given standard deviation."""
    frames, joints = len(observation.times), observation.n_joints
    images = observation.rgb if observation.depth is None else observation.depth
    sigma = np.full((frames, joints), deviation)
    sigma[0] = 0.0
    screw = None
    if priors.line is not None:
        screw = screws_of(priors.line, priors.prismatic)
    part = None if images is None else np.zeros(images.shape[:3], np.uint8)
    return Estimate(np.zeros((frames, joints)), screw, part, sigma)


def label_images(tracker: Tracker, state: Articulation) -> NDArray[np.uint8]:
    """Return labels [T H W] of all frames; pixels without a candidate are static."""
    surfaces = tracker.surfaces
    height, width = surfaces.depth[0].shape
    out = np.zeros((surfaces.frames, height, width), np.uint8)
    motion = state.motions(len(state.angle))

    def fill(frame: int) -> None:
        grid = tracker.grid(frame)
        if not len(grid.point):
            return
        cloud, _ = tracker.label(motion, frame)
        step = grid.stride
        small = np.zeros((height // step + 1, width // step + 1), np.uint8)
        small[grid.pixel[:, 1] // step, grid.pixel[:, 0] // step] = cloud.label
        out[frame] = small.repeat(step, axis=0).repeat(step, axis=1)[:height, :width]

    thread_map(fill, range(surfaces.frames))
    return out
