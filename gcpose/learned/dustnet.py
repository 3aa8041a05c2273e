"""DUST-net (Jain et al., CoRL 2021) as a method: depth video of an object with one joint."""

# pyright: basic
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import MethodError
from ...renderer.types import Estimate, Inputs, Knowledge, Observation
from ...robots.geometry import fit_depth
from ..networks.depth_video import encoder_width
from ..networks.dustnet import DustNet, recorded_frames
from ..networks.torch_runtime import torch
from .screwnet import motion_of_screws
from .trained import depth_of_one_joint, load_trained


class DustNetMethod:
    """The likeliest motion of the joint and its deviation; it looks at depth alone."""

    name = "dustnet"
    inputs: tuple[Inputs, ...] = ("rgbd",)
    knowledge: tuple[Knowledge, ...] = ("free",)
    version = "1"
    authors = "A. Jain, S. Giguere, R. Lioutikov, S. Niekum"
    link = "https://arxiv.org/abs/2108.05875"
    date = "2021-08"

    def __init__(self, weights: str = "", device: str = "auto") -> None:
        """Load the weights that `gcbench train dustnet` wrote.

        Raises:
            ConfigError: If the file is missing or has no weights of this network.
        """
        self.trained = load_trained(
            "dustnet", weights, device, encoder_width,
            lambda width, tensors: DustNet(width, max(2, recorded_frames(width, tensors))))
        self.training = self.trained.describe_training("depth video")
        self.name += f" {self.trained.label}"

    def estimate(self, observation: Observation) -> Estimate:
        """Return displacements with standard deviations, and the axis.

        Raises:
            MethodError: If there is no depth, or not one joint.
        """
        depth = fit_depth(depth_of_one_joint(observation, self.name))
        network = self.trained.network
        assert isinstance(network, DustNet)
        videos = divide_frames(len(depth), network.frames)
        with torch.no_grad():
            features = network.image_features(self.trained.tensor(depth)[None])[0]
            found = network.distribution(network.motion(features[torch.from_numpy(videos)]))
        slides = observation.joint_types[0] == "prismatic"
        precision = found.slide_precision if slides else found.turn_precision
        deviation = 1 / precision[:, None].expand(-1, network.frames - 1)
        screws = np.zeros((len(depth), 8))
        sigma = np.zeros(len(depth))
        screws[videos[:, 1:]] = found.screws().cpu().numpy()
        sigma[videos[:, 1:]] = deviation.cpu().numpy()
        if not np.isfinite(screws).all():
            raise MethodError("dustnet returned numbers that are not finite")
        displacement, screw = motion_of_screws(screws[1:], slides)
        return Estimate(displacement[:, None], screw[None], sigma=sigma[:, None])


def divide_frames(count: int, length: int) -> NDArray[np.int64]:
    """Return the frames [V `length`] of videos that all begin with frame 0 and together have all
    `count` frames; where frames are too few, the last one is repeated."""
    later = np.arange(1, count)
    videos = -(-len(later) // (length - 1))
    parts = [later[k::videos] for k in range(videos)]
    padded = [np.pad(part, (0, length - 1 - len(part)), mode="edge") for part in parts]
    return np.stack([np.append(0, part) for part in padded])
