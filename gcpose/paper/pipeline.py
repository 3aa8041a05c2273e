"""The paper's pipeline as it is written, in the steps of its ablation (Table 3).

`gcpose-flow`: parts by EM on the flow between two frames, an essential matrix for each, the angles
that explain their rotations, added up. `gcpose-epipolar`: with a flow network that is tuned to the
video. `gcpose-depth`: with depth, motions by PnP and bundle adjustment over all frames.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import GcbenchError
from ...renderer.types import Estimate, Inputs, Knowledge, Observation
from ...robots.geometry import Array
from ..chain import Articulation, ChainSettings, axes, hinges, knowledge
from ..images import (
    Flow,
    Footage,
    depth_named,
    fine_dis_flow,
    flow_named,
    footage,
    for_cuts_of,
    training_of,
)
from ..numerics import Image
from ..rgb import Guess, Rays, RayTracker, Spots, ends, observed
from .epipolar import Pair, accumulated, orders, pair_of, rotations, rotations_with_depth

_POINTS = 400  # of each frame
_SCALES = (20.0, 20.0, 10.0, 10.0, 6.0, 6.0, 4.0, 4.0)  # of the bundle adjustment
_ITERATIONS, _SIDE = 3, 240  # of the network that is tuned: sooner done, and errs by 6 % more
_RELIEF = 0.1  # standard deviation of estimated inverse depths about 1
_EXACT = 0.01  # of measured ones, and what the noise adds


class FlowOnly:
    """Sec. 3.2 and 3.3 on the flow as it is."""

    name = "gcpose-flow"
    inputs: tuple[Inputs, ...] = ("rgb",)
    knowledge: tuple[Knowledge, ...] = ("axes",)
    version = "4"

    def __init__(self, flow: str = "") -> None:
        """The name of a flow (see flow.py); default: OpenCV's DIS.

        Raises GcbenchError for names that are none, or files that are missing.
        """
        self.flow: Flow = flow_named(flow) if flow else fine_dis_flow
        if flow:
            self.name += f" flow={flow.partition(':')[0]}"
        self.training = training_of(flow)

    def estimate(self, observation: Observation) -> Estimate:
        """Angles added up over consecutive frames.

        Raises GcbenchError for a joint that slides: without scale its step cannot be known.
        """
        known, still = knowledge(observation), unmoved(observation)
        if known.prismatic.any():
            j = int(np.flatnonzero(known.prismatic)[0]) + 1
            raise GcbenchError(f"{self.name} measures turns, and joint {j} slides; use gcpose")
        seen = self.seen(observation)
        if seen is None or known.direction is None:
            return still
        s = RayTracker(seen, known)
        points = [s.points((k,), _POINTS) for k in range(seen.frames)]
        bases = [ends(s, p, k)[0] if len(p.frame) else np.zeros(3) for k, p in enumerate(points)]
        seen = self.refined(observation, seen, points, bases)
        s = RayTracker(seen, known)
        pairs = [pair_of(points[k], seen.flow[k], seen.intrinsics, s.joints, bases[k])
                 for k in range(seen.frames - 1)]
        angle = self.angles(observation, s, points, pairs, bases[0])
        return Estimate(angle) if np.isfinite(angle).all() else still

    def seen(self, observation: Observation) -> Footage | None:
        """What the images show."""
        assert observation.rgb is not None
        flow = self.flow if observation.flow is None else observation.flow
        return footage(observation.rgb, observation.intrinsics, flow, part=observation.part)

    def refined(
        self, observation: Observation, seen: Footage, points: list[Spots], bases: list[Array]
    ) -> Footage:
        """The same with a better flow."""
        return seen

    def angles(
        self, observation: Observation, s: RayTracker, points: list[Spots],
        pairs: list[Pair | None], base: Array,
    ) -> Array:
        """[T J] displacements."""
        assert s.known.direction is not None
        steps = [[None] * s.joints if p is None else rotations(p) for p in pairs]
        return accumulated(pairs, steps, s.known.direction, s.known.parent,
                           allowed(observation))[0]


class Epipolar(FlowOnly):
    """The same with a flow network that is tuned to the video by the epipolar constraint.

    Default: the network whose weights come with gcbench. It takes a little over
    a minute of a core for a sequence.
    """

    name = "gcpose-epipolar"
    version = "6"

    def __init__(self, flow: str = "") -> None:
        """The name of a flow that is a network: "raft:WEIGHTS" or "flownet2:CHECKPOINT".

        Raises GcbenchError for others, files that are missing, or where PyTorch is.
        """
        super().__init__(flow)
        from ..images.raft_flow import raft_flow
        from .fine_tune import tuned

        if not flow:
            self.flow = raft_flow(iterations=_ITERATIONS, side=_SIDE)
        self.network: Any = self.flow
        if not hasattr(self.flow, "network"):
            raise GcbenchError(f"{self.name}: no network to tune; use raft:WEIGHTS or "
                               "flownet2:CHECKPOINT")
        self.tuned = tuned
        self.training = f"{training_of(flow or 'raft')}; self-supervised on the video"

    def refined(
        self, observation: Observation, seen: Footage, points: list[Spots], bases: list[Array]
    ) -> Footage:
        """The same with the tuned network's flow, but for an oracle's."""
        rgb = observation.rgb
        if rgb is None or observation.flow is not None:
            return seen
        height, width = seen.moving.shape[1:]
        left, top = seen.corner
        cut = np.ascontiguousarray(rgb[:, top : top + height, left : left + width])

        def parts(k: int, flow: Image) -> Pair | None:
            return pair_of(points[k], flow, seen.intrinsics, observation.n_joints, bases[k])

        focal = float(seen.intrinsics[0, 0])
        network: Any = for_cuts_of(self.network, *rgb.shape[1:3])
        return replace(seen, flow=self.tuned(network, cut, seen.moving, focal, parts))


class WithDepth(Epipolar):
    """The same with depth: measured, or a network's."""

    name = "gcpose-depth"
    inputs: tuple[Inputs, ...] = ("rgb", "rgbd", "rgbd-noise")

    def __init__(self, flow: str = "", depth: str = "") -> None:
        """Also the name of a depth network (see depth.py), without which `rgb` is no track."""
        super().__init__(flow)
        self.depth = depth_named(depth) if depth else None
        if self.depth is None:
            self.inputs = ("rgbd", "rgbd-noise")
            self.hint = "with --depth mono:FOLDER (Monodepth2's weights) rgb, too"
        if depth not in ("", "none"):
            self.name += f" depth={depth.partition(':')[0]}"
            self.training = f"{training_of(depth)}; {self.training}"

    def seen(self, observation: Observation) -> Footage | None:
        """What the images show, with depth.

        Raises GcbenchError if there is none.
        """
        depth = self.depth if observation.depth is None else observation.depth
        if depth is None:
            raise GcbenchError(f"{self.name} needs depth: --depth mono:FOLDER with Monodepth2's "
                               "weights, or --inputs rgbd")
        assert observation.rgb is not None
        flow = self.flow if observation.flow is None else observation.flow
        return footage(observation.rgb, observation.intrinsics, flow, depth, observation.part)

    def angles(
        self, observation: Observation, s: RayTracker, points: list[Spots],
        pairs: list[Pair | None], base: Array,
    ) -> Array:
        """[T J] displacements after bundle adjustment with the accumulated points (Sec. 3.4)."""
        assert s.known.direction is not None
        focal = float(s.seen.intrinsics[0, 0])
        steps = [[None] * s.joints if p is None else rotations_with_depth(p, q.expected, focal)
                 for p, q in zip(pairs, points[:-1], strict=True)]
        angle, joint = accumulated(pairs, steps, s.known.direction, s.known.parent,
                                   allowed(observation))
        keys = [k for k, p in enumerate(pairs) if p is not None]
        if not keys or keys[0]:
            return angle
        cloud = s.points(tuple(keys), _POINTS)
        label = np.concatenate([joint[k][p.label - 1] + 1 for k, p in enumerate(pairs)
                                if p is not None])
        first = points[0]
        at = hinges(first.ray / first.expected[:, None], label[: len(first.frame)], base,
                    s.known.parent, ChainSettings())
        twist = np.concatenate([axes(s.known, j, l[None], at[j : j + 1])
                                for j, l in enumerate(s.known.direction)])
        state = Articulation(twist, angle, s.known.prismatic, s.known.parent)
        mine = label > 0
        rays = Rays.unseen(cloud.frame[mine], cloud.ray[mine], label[mine], cloud.expected[mine])
        guess = Guess(state, rays, base, np.inf, np.zeros((0, 0)))
        spread = _RELIEF
        if observation.depth is not None:
            seen = observation.depth[observation.depth > 0]
            spread = float(np.hypot(_EXACT, observation.depth_noise / max(1e-6, np.median(seen))))
        for scale in _SCALES:
            rays = observed(s.seen, guess.state, guess.rays)
            guess = s.fitted(guess, rays, (scale,), 1.0, spread)
        return guess.state.angle


def allowed(observation: Observation) -> list[NDArray[np.int64]]:
    """Which joints parts may belong to: parts of an oracle are known."""
    joints = observation.n_joints
    return orders(joints) if observation.part is None else [np.arange(joints)]


def unmoved(observation: Observation) -> Estimate:
    """No motion, where nothing is seen to move."""
    return Estimate(np.zeros((len(observation.times), observation.n_joints)))
