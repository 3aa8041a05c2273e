"""ScrewNet (Jain et al., ICRA 2021) as a method: depth video of an object with one joint."""

# pyright: basic
from __future__ import annotations

import numpy as np

from ...errors import MethodError
from ...renderer.types import Estimate, Inputs, Knowledge, Observation
from ...robots.geometry import Array, fit_depth
from ..networks.depth_video import encoder_width
from ..networks.screwnet import ScrewNet
from ..networks.torch_runtime import torch
from .trained import depth_of_one_joint, load_trained


class ScrewNetMethod:
    """The motion of the joint by the network of a file of weights; it looks at depth alone."""

    name = "screwnet"
    inputs: tuple[Inputs, ...] = ("rgbd",)
    knowledge: tuple[Knowledge, ...] = ("free",)
    version = "2"
    authors = "A. Jain, R. Lioutikov, C. Chuck, S. Niekum"
    link = "https://arxiv.org/abs/2008.10518"
    date = "2020-08"

    def __init__(self, weights: str = "", device: str = "auto") -> None:
        """Load the weights that `gcbench train screwnet` wrote.

        Raises:
            ConfigError: If the file is missing or has no weights of this network.
        """
        self.trained = load_trained(
            "screwnet", weights, device, encoder_width, lambda width, _: ScrewNet(width))
        self.training = self.trained.describe_training("depth video")
        self.name += f" {self.trained.label}"

    def estimate(self, observation: Observation) -> Estimate:
        """Return displacements, and the mean axis.

        Raises:
            MethodError: If there is no depth, or not one joint.
        """
        depth = self.trained.tensor(fit_depth(depth_of_one_joint(observation, self.name)))
        with torch.no_grad():
            found = self.trained.network(depth[None])[0].cpu().numpy().astype(np.float64)
        prismatic = observation.joint_types[0] == "prismatic"
        displacement, screw = motion_of_screws(found, prismatic)
        if not np.isfinite(found).all():
            raise MethodError("screwnet returned numbers that are not finite")
        return Estimate(displacement[:, None], screw[None])


def motion_of_screws(found: Array, prismatic: bool) -> tuple[Array, Array]:
    """Return displacements [T] and one screw [6] of the network's screws [T-1 8].

    The axis of the largest displacement gives the direction; where that of another frame is
    opposite, the displacement is negative. The screw is the mean of all, weighted by displacement.
    """
    size = found[:, 7 if prismatic else 6]
    largest = found[int(np.argmax(np.abs(size)))]
    sign = np.where(found[:, :3] @ (np.sign(largest[7 if prismatic else 6]) * largest[:3]) < 0,
                    -1.0, 1.0)
    mean = (np.abs(size) * sign) @ found[:, :6]
    length = np.linalg.norm(mean[:3])
    l = mean[:3] / length if length > 0 else np.array([1.0, 0.0, 0.0])
    m = mean[3:] / max(length, 1e-12)
    moment = np.zeros(3) if prismatic else m - (m @ l) * l
    return np.append(0.0, sign * size), np.concatenate([l, moment])
