"""What a method may see of a sequence, and what it returns: the types that methods are built on.

They stand here, beside the sequence, so that a method does not import the benchmark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ...robots.model import ArticulatedModel

Inputs = Literal["none", "rgb", "rgbd", "rgbd-noise"]
Knowledge = Literal["none", "free", "axes", "kinematics", "model"]


@dataclass(frozen=True, eq=False)
class Observation:
    """T frames of H x W pixels, J scored joints. What the method's knowledge lacks is None."""

    rgb: NDArray[np.uint8] | None
    """[T H W 3]; None at knowledge `none`."""
    depth: NDArray[np.float32] | None
    """[T H W] z in the camera frame, m, 0 = no surface; None on the `rgb` track."""
    intrinsics: Array
    """[3 3] px"""
    times: Array
    """[T] s"""
    n_joints: int
    """Number of scored joints."""
    joint_types: tuple[str, ...]
    """[J] "revolute", "continuous" or "prismatic", from the base outward."""
    joint_parent: tuple[int, ...] = ()
    """[J] which scored joint carries each, -1 for none; empty: each is carried by the one before.
    """
    depth_noise: float = 0.0
    """Standard deviation of the depth's noise, m (the track says it)."""
    cam_from_world: Array | None = None
    """[4 4]; at knowledge `axes` and above."""
    axis_direction: Array | None = None
    """[J 3] unit, camera frame at frame 0; at `axes` and above."""
    axis_line: Array | None = None
    """[J 6] (l, m = p x l), camera frame at frame 0, prismatic (l, 0); from `kinematics` on."""
    model: ArticulatedModel | None = None
    """At `model`."""
    part: NDArray[np.uint8] | None = None
    """[T H W] true parts, 0 still background, j what scored joint j is the last to move; only for
    an oracle row."""
    flow: NDArray[np.float32] | None = None
    """[T-1 H W 2] true flow, px; only for an oracle row."""
    mask: NDArray[np.bool_] | None = None
    """[T H W] whether a scored joint moves what the pixel shows; only for an oracle row."""
    flow_backward: NDArray[np.float32] | None = None
    """[T-1 H W 2] true flow, px, of frame t+1 to t; only for an oracle row."""

    @property
    def parents(self) -> NDArray[np.int64]:
        """[J] `joint_parent`, also where it was left empty."""
        return np.array(self.joint_parent or range(-1, self.n_joints - 1), np.int64)


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a method returns."""

    displacement: Array
    """[T J] of each scored joint since frame 0, rad or m, from the base outward; row 0 is 0."""
    screw: Array | None = None
    """[J 6] each joint's axis in the camera frame at frame 0."""
    part: NDArray[np.uint8] | None = None
    """[T H W] estimated parts, 0 still background, j = 1..J what joint j is the last to move."""
    sigma: Array | None = None
    """[T J] standard deviation of the displacement, rad or m."""
    reliable: NDArray[np.bool_] | None = None
    """[J] whether the displacement at the last frame can be believed: True promises an error of at
    most 10 deg, or 0.1 m, in 95 % of the cases."""


class Method(Protocol):
    """Anything with these; there is nothing to inherit.

    A method may also have the texts `authors`, `link` (http:// or https://) and `date` (YYYY-MM-DD,
    YYYY-MM or YYYY), which the report shows.
    """

    @property
    def name(self) -> str:
        """Name in tables: up to 200 printable characters without @."""
        ...

    @property
    def version(self) -> str:
        """Version of the method. Raise it with each change of the estimates: estimates of another
        version are not mixed with those of this one."""
        ...

    @property
    def training(self) -> str:
        """"none", "self-supervised" or "supervised: on what"."""
        ...

    @property
    def inputs(self) -> Sequence[str]:
        """Tracks that it supports: "rgb", "rgbd", "rgbd-noise", or "none" alone."""
        ...

    @property
    def knowledge(self) -> Sequence[str]:
        """Knowledge levels that it supports: "free", "axes", "kinematics", "model", or "none"."""
        ...

    def estimate(self, observation: Observation) -> Estimate:
        """Estimate the motion of one sequence."""
        ...
