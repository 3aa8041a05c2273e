"""GC-Pose with depth: the stages of the paper in order (Fig. 2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..renderer.observation import Estimate, Inputs, Knowledge, Observation
from ..robots.geometry import Array
from .articulation import Hypothesis, knowledge, search
from .bundle import adjust
from .chain import screws_of
from .flow import Flow, dis_flow
from .segment import candidates, changed
from .surface import measure

_CANDIDATES = 2500


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
        surfaces = measure(observation.depth, observation.intrinsics)
        moving = changed(surfaces)
        grid = candidates(surfaces, moving, _CANDIDATES)
        still = ~moving & (surfaces.depth[0] > 0)
        v, u = np.nonzero(still[::4, ::4])
        base = surfaces.points(0, np.stack([u, v], axis=1) * 4)
        best = search(surfaces, observation.rgb, grid, base, known, self.flow)
        last = surfaces.frames - 1
        state, hessian = adjust(surfaces, grid.point, best.label, best.state, known.freedom, last, (1.0, 0.7, 0.7, 0.7))
        joints = len(known.prismatic)
        sigma = np.zeros((last + 1, joints))
        variance = np.diag(np.linalg.inv(hessian + 1e-9 * np.eye(len(hessian))))
        sigma[1:] = np.sqrt(np.maximum(variance[: last * joints], 0)).reshape(last, joints)
        self.log = f"cost {best.cost:.3f}"
        return Estimate(state.angle, screws_of(state.twist, state.prismatic), parts(observation.depth, grid.pixel, grid.stride, best), sigma)


def parts(depth: NDArray[np.float32], pixel: NDArray[np.int64], stride: int, best: Hypothesis) -> NDArray[np.uint8]:
    """[T H W]"""
    out = np.zeros(depth.shape, np.uint8)
    h = stride
    for (u, v), l in zip(pixel, best.label, strict=True):
        out[0, v : v + h, u : u + h] = l
    return out


