"""GC-Pose with depth: the stages of the paper in order (Fig. 2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..renderer.observation import Estimate, Inputs, Knowledge, Observation
from .articulation import Hypothesis, Tracker, knowledge, search
from .bundle import adjust
from .chain import screws_of
from .denoise import smoothed
from .flow import Flow, dis_flow
from .surface import measure

_CANDIDATES = 1500


class GCPose:
    """Articulated motion from an RGB-D video and nothing but geometric constraints."""

    name = "gcpose"
    inputs: tuple[Inputs, ...] = ("rgbd", "rgbd-noise")
    knowledge: tuple[Knowledge, ...] = ("free", "axes", "kinematics")
    training = "none"
    version = "1"

    def __init__(self, flow: Flow = dis_flow) -> None:
        self.flow = flow

    def estimate(self, observation: Observation) -> Estimate:
        """Sec. 3.2 to 3.4 on one sequence."""
        assert observation.depth is not None and observation.rgb is not None
        known = knowledge(
            np.array([t == "prismatic" for t in observation.joint_types]),
            observation.axis_direction,
            observation.axis_line,
        )
        if observation.depth_noise > 0:
            surfaces = smoothed(
                observation.depth,
                observation.rgb,
                observation.intrinsics,
                observation.depth_noise,
                self.flow,
            )
        else:
            surfaces = measure(observation.depth, observation.intrinsics)
        tracker = Tracker(surfaces, observation.rgb, known, _CANDIDATES)
        best = search(tracker, self.flow)
        fine = (1.0, 0.6, 0.4, 0.4) if surfaces.noise else (1.0, 0.7, 0.7)
        state, sigma = adjust(
            surfaces,
            best.clouds,
            best.state,
            known.freedom,
            fine,
            tracker.hinges(best.clouds[0]),
            fine=True,
        )
        self.tracker, self.best = tracker, best
        self.log = f"cost {best.cost:.3f}"
        screw = screws_of(state.twist, state.prismatic)
        return Estimate(state.angle, screw, parts(tracker, best), sigma)


def parts(tracker: Tracker, best: Hypothesis) -> NDArray[np.uint8]:
    """[T H W]"""
    out = np.zeros(tracker.surfaces.depth.shape, np.uint8)
    for cloud in best.clouds:
        grid = tracker.grid(cloud.frame)
        h = grid.stride
        for (u, v), l in zip(grid.pixel, cloud.label, strict=True):
            out[cloud.frame, v : v + h, u : u + h] = l
    return out
