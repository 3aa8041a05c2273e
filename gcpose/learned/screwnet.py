"""ScrewNet (Jain et al., ICRA 2021) as a method: depth video of an object with one joint."""

# pyright: basic
from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import ConfigError, MethodError
from ...renderer.types import Estimate, Inputs, Knowledge, Observation
from ...robots.geometry import Array
from ..networks.screwnet import ScrewNet, fit_depth, screwnet_width
from ..networks.torch_runtime import device_named, torch
from ..networks.weights import read_notes, read_tensors, read_weights

_TRAIN = "gcbench train screwnet --out screwnet, then --weights screwnet/screwnet.safetensors"


class ScrewNetMethod:
    """The motion of the joint by the network of a file of weights; it looks at depth alone."""

    name = "screwnet"
    inputs: tuple[Inputs, ...] = ("rgbd",)
    knowledge: tuple[Knowledge, ...] = ("free",)
    version = "1"

    def __init__(self, weights: str = "", device: str = "auto") -> None:
        """Load the weights that `gcbench train screwnet` wrote.

        Raises:
            ConfigError: If the file is missing or has no weights of this network.
        """
        if not weights:
            raise ConfigError(f"screwnet needs weights: {_TRAIN}")
        path = Path(weights)
        width = screwnet_width(read_tensors(path))
        if not 8 <= width <= 64:
            raise ConfigError(f"{path}: no weights of screwnet; make them with {_TRAIN}")
        self.network = ScrewNet(width).eval()
        self.network.load_state_dict(
            read_weights(path, self.network.state_dict(), "screwnet"))
        self.network.to(device_named(device))
        self.device = device_named(device)
        objects = read_notes(path).get("objects", "unknown objects")[:100]
        self.training = f"supervised: depth video of {objects}"
        self.name += f" {objects.replace(', ', '+')}" + (f" width={width}" if width < 64 else "")

    def estimate(self, observation: Observation) -> Estimate:
        """Return displacements, and the mean axis.

        Raises:
            MethodError: If there is no depth, or not one joint.
        """
        if observation.depth is None:
            raise MethodError("screwnet needs depth: --inputs rgbd")
        if observation.n_joints != 1:
            raise MethodError(f"screwnet sees one joint; this object has {observation.n_joints}")
        depth = torch.from_numpy(fit_depth(observation.depth))[None].to(self.device)
        with torch.no_grad():
            found = self.network(depth)[0].cpu().numpy().astype(np.float64)
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
