"""Abbatematteo, Tellex and Konidaris (CoRL 2019) as a method: each depth image by itself."""

# pyright: basic
from __future__ import annotations

import numpy as np

from ...errors import MethodError
from ...renderer.types import Estimate, Inputs, Knowledge, Observation
from ...robots.geometry import Array, fit_depth, move_screw, rotation_from_quaternion, transform
from ..networks.abbatematteo import AXIS, CONFIGURATION, POSE, MixtureDensityNetwork, mixture_width
from ..networks.torch_runtime import torch
from .trained import depth_of_one_joint, load_trained


class Abbatematteo:
    """Joint positions by the mean of the heaviest component; it looks at depth alone."""

    name = "abbatematteo"
    inputs: tuple[Inputs, ...] = ("rgbd",)
    knowledge: tuple[Knowledge, ...] = ("free",)
    version = "3"
    authors = "B. Abbatematteo, S. Tellex, G. Konidaris"
    link = "http://bigai.cs.brown.edu/2019/11/04/kinematics.html"
    date = "2019"

    def __init__(self, weights: str = "", device: str = "auto") -> None:
        """Load the weights that `gcbench train abbatematteo` wrote.

        Raises:
            ConfigError: If the file is missing or has no weights of this network.
        """
        self.trained = load_trained(
            "abbatematteo", weights, device, mixture_width,
            lambda width, _: MixtureDensityNetwork(width))
        self.training = self.trained.describe_training("depth images")
        self.name += f" {self.trained.label}"

    def estimate(self, observation: Observation) -> Estimate:
        """Return the differences of the positions to frame 0, and the axis in frame 0.

        Raises:
            MethodError: If there is no depth, or not one joint.
        """
        depth = self.trained.tensor(fit_depth(depth_of_one_joint(observation, self.name)))
        network = self.trained.network
        assert isinstance(network, MixtureDensityNetwork)
        with torch.no_grad():
            found = network.likeliest(depth).cpu().numpy().astype(np.float64)
        if not np.isfinite(found).all():
            raise MethodError("abbatematteo returned numbers that are not finite")
        position = found[:, CONFIGURATION]
        screw = camera_screw(found[0], observation.joint_types[0] == "prismatic")
        return Estimate((position - position[0])[:, None], screw[None])


def camera_screw(numbers: Array, prismatic: bool) -> Array:
    """Return the screw [6] in the camera frame of the numbers [22] of an image."""
    axis, pose = numbers[AXIS], numbers[POSE]
    direction = _rotation(axis[3:])[:, 0]
    moment = np.zeros(3) if prismatic else np.cross(axis[:3], direction)
    cam_from_body = transform(_rotation(pose[3:]), pose[:3])
    return move_screw(cam_from_body, np.concatenate([direction, moment]), prismatic)


def _rotation(quaternion: Array) -> Array:
    """Return the rotation [3 3] of a quaternion [4] of any length; zero gives no rotation."""
    length = float(np.linalg.norm(quaternion))
    return rotation_from_quaternion(quaternion / length) if length > 1e-6 else np.eye(3)
