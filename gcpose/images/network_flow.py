"""Optical flow by networks: weights from a file, images of any size."""

# pyright: basic
from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ..networks import flownet2, raft
from ..networks.torch_runtime import F, find_device, nn, pad_image, torch, unit_range
from ..networks.weights import read_weights
from .raft_network import RAFT_TRAINING, RAFT_WEIGHTS
from .settings import FlowSettings

_DEFAULT = FlowSettings()


def find_network_flow(name: str, settings: FlowSettings = _DEFAULT) -> NetworkFlow:
    """Return the flow of a network, which can be tuned, by the name that `find_flow` takes.

    Raises:
        ConfigError: If the name is of no network, or a file is missing or does not fit.
        MethodError: If torchvision is missing.
    """
    kind, _, file = name.partition(":")
    if kind == "raft":
        return load_tunable_raft(Path(file) if file else RAFT_WEIGHTS, settings)
    if kind == "flownet2":
        if not file:
            raise ConfigError(
                "flownet2 needs its checkpoint, which is not distributed with gcbench: "
                "--flow flownet2:FlowNet2_checkpoint.pth.tar"
            )
        return load_flownet2(Path(file), settings)
    if kind == "torchvision":
        network, _, weights = file.partition(":")
        return load_torchvision(network, weights, settings)
    raise ConfigError(f"no network to tune in the flow {name!r}; use raft:WEIGHTS, "
                      "flownet2:CHECKPOINT or torchvision:NAME")


def load_tunable_raft(
    weights: Path = RAFT_WEIGHTS, settings: FlowSettings = _DEFAULT, device: str = "auto"
) -> RaftFlow:
    """Load the flow with the weights of a safetensors file; default: those that gcbench has.

    `raft_network.load_raft` computes the same without PyTorch.

    Raises:
        ConfigError: If the file is missing or holds another network's weights.
    """
    network = raft.Raft()
    network.load_state_dict(read_weights(weights, network.state_dict(), "raft"))
    return RaftFlow(network.to(find_device(device)), settings)


class NetworkFlow(ABC):
    """The flow of a network; it has the attributes of `Tunable` (paper/fine_tune.py)."""

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the flow [H W 2] px."""
        with torch.no_grad():
            out = self.tensor(rgb_a, rgb_b)
        return out[0].permute(1, 2, 0).cpu().numpy()

    @abstractmethod
    def tensor(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> torch.Tensor:
        """Return the flow [1 2 H W] px, with gradients."""


class RaftFlow(NetworkFlow):
    """The flow of a `Raft` network, enlarged to the resolution of the images."""

    training = RAFT_TRAINING

    def __init__(
        self, network: raft.Raft, settings: FlowSettings = _DEFAULT, factor: float = 0
    ) -> None:
        """`factor`: reduction of the images; default: as the settings say."""
        self.network, self.settings, self.factor = network.eval(), settings, factor
        self.rate = settings.raft_rate

    def for_cuts_of(self, height: int, width: int) -> RaftFlow:
        """Return the same for crops of images of a size, reduced as whole images are."""
        return RaftFlow(self.network, self.settings, self.settings.raft_reduction(height, width))

    def tensor(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> torch.Tensor:
        """Return the flow [1 2 H W] px, with gradients."""
        height, width = rgb_a.shape[:2]
        factor = self.factor or self.settings.raft_reduction(height, width)
        small = (max(1, round(width / factor)), max(1, round(height / factor)))
        device = next(self.network.parameters()).device
        a, b = (
            pad_image(unit_range(np.asarray(cv2.resize(image, small, interpolation=cv2.INTER_AREA),
                                         np.uint8)), raft.RAFT_MULTIPLE).to(device)
            for image in (rgb_a, rgb_b)
        )
        flow = self.network(a, b, self.settings.raft_iterations).fine[..., : small[1], : small[0]]
        full = F.interpolate(flow, size=(height, width), mode="bilinear", align_corners=False)
        by = torch.tensor([width / small[0], height / small[1]], device=device)
        return full * by[:, None, None]


def load_flownet2(
    checkpoint: Path, settings: FlowSettings = _DEFAULT, device: str = "auto"
) -> PaddedFlow:
    """Load the flow of `FlowNet2_checkpoint.pth.tar`, about 270 GFLOP for 640 x 480 pixels.

    Raises:
        ConfigError: If the file is missing or holds another network's weights.
    """
    with torch.device("meta"):  # saves the initialization of weights that are replaced
        network = flownet2.FlowNet2()
    weights = read_weights(checkpoint, network.state_dict(), "FlowNet2")
    network.load_state_dict(weights, assign=True)
    network.to(find_device(device)).eval()
    return PaddedFlow(network, network, settings.flownet2_rate,
                      "supervised: FlyingChairs and FlyingThings3D", flownet2.FLOWNET2_MULTIPLE)


def load_torchvision(
    name: str, weights: str = "", settings: FlowSettings = _DEFAULT, device: str = "auto"
) -> PaddedFlow:
    """Load the flow of a RAFT of torchvision, see `load_torchvision_raft`.

    Raises:
        ConfigError: If a name is unknown, or the weights cannot be read or downloaded.
        MethodError: If torchvision is missing.
    """
    from ..networks import torchvision_raft as loader

    network, training = loader.load_torchvision_raft(name, weights)
    network.to(find_device(device)).eval()
    return PaddedFlow(
        network, lambda a, b: network(2 * a - 1, 2 * b - 1)[-1], settings.raft_rate, training,
        loader.TORCHVISION_MULTIPLE, loader.TORCHVISION_MIN_SIDE)


@dataclass(frozen=True)
class PaddedFlow(NetworkFlow):
    """The flow of a network that sees images as they are, padded at the right and below."""

    network: nn.Module
    run: Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
    """Returns the flow [1 2 H W] px of padded images [1 3 H W] in 0..1"""
    rate: float
    training: str
    multiple: int
    """Sides must be multiples of this, px"""
    min_side: int = 1
    """And not less than this, px"""

    def tensor(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> torch.Tensor:
        """Return the flow [1 2 H W] px, with gradients."""
        height, width = rgb_a.shape[:2]
        place = next(self.network.parameters()).device
        a, b = (pad_image(unit_range(image), self.multiple, self.min_side).to(place)
                for image in (rgb_a, rgb_b))
        return self.run(a, b)[..., :height, :width]
