"""Baselines that never look at an image. They belong in every table: if all objects move at one
speed, such a baseline can have the smallest error."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ...renderer.scene import RenderConfig, Streams
from ...renderer.types import Estimate, Inputs, Knowledge, Observation
from ...robots.geometry import Array
from ...robots.model import ArticulatedModel, Joint, JointType, Link
from ...robots.motion import MotionRanges, sample_trajectory

TRAINING = RenderConfig(stream="train", twin_of="")
"""The recipe whose motion is learned: the suites' own, of the stream that no suite holds."""
SEQUENCES = 512
_SLIDE = 0.4  # m, range of the prismatic joint that is learned from: a drawer's


class HoldStill:
    """No motion at all: its error is the true displacement."""

    name = "hold-still"
    version = "1"
    training = "none"
    inputs: tuple[Inputs, ...] = ("none",)
    knowledge: tuple[Knowledge, ...] = ("none",)

    def estimate(self, observation: Observation) -> Estimate:
        """Zeros."""
        return Estimate(np.zeros((len(observation.times), observation.n_joints)))


class ConstantVelocity:
    """The training set's mean motion, as far as it can be told without an image.

    Directions are random, so the plain mean is no motion. Without axes a direction has no sign, and
    the protocol uses the better one (the row says `best`). The mean is therefore over motions that
    are turned to one sign.
    """

    name = "constant-velocity"
    version = "1"
    training = "supervised: motions of the train stream"
    inputs: tuple[Inputs, ...] = ("none",)
    knowledge: tuple[Knowledge, ...] = ("none",)

    def estimate(self, observation: Observation) -> Estimate:
        """The same for each joint of a kind."""
        frames = len(observation.times)
        return Estimate(
            np.stack(
                [mean_motion(frames, kind == "prismatic") for kind in observation.joint_types],
                axis=1,
            )
        )


@lru_cache(maxsize=16)
def mean_motion(frames: int, prismatic: bool) -> Array:
    """[T] rad or m since frame 0: mean over training motions, each turned to end positive.

    Learned from a joint that has room for every motion of the recipe (prismatic: 0.4 m).
    """
    config = TRAINING.randomization.motion
    ranges = MotionRanges.from_degrees(
        config.total, config.total_prismatic, config.max_step, config.fps)
    model = _one_joint(prismatic)
    motions: list[Array] = []
    for index in range(SEQUENCES):
        motion = sample_trajectory(
            model,
            ("joint",),
            frames,
            ranges,
            rng=Streams(TRAINING, index).rng("motion"),
        ).positions[:, 0]
        motions.append((motion - motion[0]) * np.sign(motion[-1] - motion[0]))
    return np.mean(motions, axis=0)


def _one_joint(prismatic: bool) -> ArticulatedModel:
    joint_type = JointType.PRISMATIC if prismatic else JointType.REVOLUTE
    limits = (0.0, _SLIDE) if prismatic else (-np.pi, np.pi)
    joint = Joint("joint", joint_type, limits=limits)
    return ArticulatedModel.from_links("joint", [Link("base"), Link("part", "base", joint=joint)])
