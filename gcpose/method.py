"""GC-Pose: the stages of the paper in order (Fig. 2); with depth here, without it in `rgb.py`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..renderer.types import Estimate, Inputs, Knowledge, Observation
from ..robots.geometry import Array
from .chain import Articulation, Known, knowledge, screws_of
from .images import (
    Flow,
    depth_named,
    dis_flow,
    fine_dis_flow,
    flow_named,
    measure,
    smoothed,
    training_of,
)
from .numerics import together
from .rgb import estimate_rgb
from .rgbd import Tracker, adjust, deviation, lively, lost, search

_CANDIDATES = 1500, 900  # and with noise, where what is near errs alike
_FEWEST = 30  # lively pixels that are worth a search
_CLUELESS = 1.0  # standard deviation of a displacement that nothing was seen of, rad or m
_CALIBRATION = {0: 2.7, 2: 2.9, 4: 2.5}  # of standard deviations, by the axes' freedom
_LOST = np.radians(10.0)  # and where much stays unexplained
_NOISY = (8.2, np.radians(0.1))  # where depth is noisy: factor, and the least


class GCPose:
    """Articulated motion from a video and nothing but geometric constraints."""

    name = "gcpose"
    inputs: tuple[Inputs, ...] = ("rgb", "rgbd", "rgbd-noise")
    knowledge: tuple[Knowledge, ...] = ("free", "axes", "kinematics")
    version = "13"

    def __init__(self, flow: Flow | str = "", depth: str = "") -> None:
        """A flow, or the name of one (see flow.py), and of a depth network (see depth.py).

        Raises GcbenchError for names that are none, or files that are missing.
        """
        named = flow_named(flow) if isinstance(flow, str) and flow else flow
        self.flow = dis_flow if isinstance(named, str) else named
        self.fine_flow = fine_dis_flow if isinstance(named, str) else named
        self.depth = depth_named(depth) if depth else None
        chosen = {"flow": flow if isinstance(flow, str) else "", "depth": depth}
        self.name += "".join(f" {k}={v.partition(':')[0]}" for k, v in chosen.items()
                             if v not in ("", "none"))
        self.training = training_of(*chosen.values())

    def estimate(self, observation: Observation) -> Estimate:
        """Sec. 3.2 to 3.4 on one sequence; where nothing can be seen to move, no motion."""
        with threadpool_limits(1, "blas"):  # over small matrices its threads wait for each other
            return self._estimate(observation)

    def _estimate(self, observation: Observation) -> Estimate:
        known = knowledge(observation)
        rgb = observation.rgb
        if observation.depth is None:
            found = estimate_rgb(observation, known, self.fine_flow, self.depth)
            return found or unmoved(observation, known)
        if rgb is None or len(observation.depth) < 2:
            return unmoved(observation, known)
        noise = observation.depth_noise
        if noise > 0:
            surfaces = smoothed(observation.depth, rgb, observation.intrinsics, noise, self.flow)
        else:
            surfaces = measure(observation.depth, observation.intrinsics)
        where = lively(surfaces, rgb)
        if np.count_nonzero(where[0]) < _FEWEST:
            return unmoved(observation, known)
        tracker = Tracker(surfaces, rgb, where, known, _CANDIDATES[noise > 0])
        best = search(tracker, self.flow)
        state, sums = adjust(
            replace(surfaces, flow=None),
            best.clouds,
            best.state,
            known.freedom,
            (1.0, 0.6, 0.4, 0.4) if noise else (0.25, 0.12, 0.12),
            tracker.hinges(best),
        )
        sigma = deviation(sums, *state.angle.shape)
        if not (np.isfinite(state.angle).all() and np.isfinite(sigma).all()):
            return unmoved(observation, known)
        return Estimate(
            displacement=state.angle,
            screw=screws_of(state.twist, state.prismatic),
            part=parts(tracker, state),
            sigma=calibrated(sigma, known, noise > 0, lost(tracker, best)),
        )


def calibrated(sigma: Array, known: Known, noisy: bool, lost: bool) -> Array:
    """Standard deviations [T J] that two thirds of the errors lie within.

    What errs together (labels, smoothing, the bend of surfaces within a pixel) is more than the
    residuals show: factor and floor are from training sequences.
    """
    factor, floor = _NOISY if noisy else (_CALIBRATION[known.freedom], 0.0)
    if lost:
        floor = _LOST
    out = np.minimum(np.hypot(factor * sigma, floor), _CLUELESS)
    out[0] = 0.0
    return out


def unmoved(observation: Observation, known: Known) -> Estimate:
    """The estimate where there is nothing to see: no motion, and no trust in it."""
    frames, joints = len(observation.times), observation.n_joints
    images = observation.rgb if observation.depth is None else observation.depth
    sigma = np.full((frames, joints), _CLUELESS)
    sigma[0] = 0.0
    screw = None
    if known.line is not None:
        screw = screws_of(known.line, known.prismatic)
    part = None if images is None else np.zeros(images.shape[:3], np.uint8)
    return Estimate(np.zeros((frames, joints)), screw, part, sigma)


def parts(tracker: Tracker, state: Articulation) -> NDArray[np.uint8]:
    """[T H W] labels of all frames; what no candidate stands for is still."""
    surfaces = tracker.surfaces
    height, width = surfaces.depth[0].shape
    out = np.zeros((surfaces.frames, height, width), np.uint8)

    def fill(frame: int) -> None:
        grid = tracker.grid(frame)
        if not len(grid.point):
            return
        cloud, _ = tracker.label(state, frame)
        step = grid.stride
        small = np.zeros((height // step + 1, width // step + 1), np.uint8)
        small[grid.pixel[:, 1] // step, grid.pixel[:, 0] // step] = cloud.label
        out[frame] = small.repeat(step, axis=0).repeat(step, axis=1)[:height, :width]

    together(fill, range(surfaces.frames))
    return out
