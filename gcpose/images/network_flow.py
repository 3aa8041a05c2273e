"""Optical flow by networks: weights from a file, images of any size."""

# pyright: basic
from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..networks import flownet2, raft
from ..networks.torch_runtime import F, device_named, padded, torch, unit_range
from ..networks.weights import read_weights

SHIPPED = Path(__file__).parents[1] / "weights" / "raft.safetensors"
_SIDE = 320
"""Smaller side of the images that the network sees, px. It was trained on images of 0.75 to 1.6
times 240 px, and its errors are least at this size."""


def load_raft(
    weights: Path = SHIPPED, device: str = "auto", iterations: int = 6, side: int = _SIDE
) -> RaftFlow:
    """Load the flow with the weights of a file; default: those that come with gcbench.

    Args:
        weights: A safetensors file.
        device: "auto", "cpu", "cuda", ...
        iterations: Corrections that the network makes.
        side: Images are reduced so that their smaller side is at most this, px.

    Raises:
        ConfigError: If the file is missing or holds another network's weights.
    """
    network = raft.Raft()
    network.load_state_dict(read_weights(weights, network.state_dict(), "raft"))
    return RaftFlow(network.to(device_named(device)), iterations, side)


class RaftFlow:
    """The flow of a `Raft` network, enlarged to the resolution of the images."""

    rate = 1e-4
    """Learning rate at which it is tuned to a video"""

    def __init__(
        self, network: raft.Raft, iterations: int = 6, side: int = _SIDE, factor: float = 0
    ) -> None:
        """`factor`: reduction of the images; default: such that `side` px are left."""
        self.network = network.eval()
        self.iterations, self.side, self.factor = iterations, side, factor

    def for_cuts_of(self, height: int, width: int) -> RaftFlow:
        """Return the same for crops of images of a size, reduced as whole images are."""
        return RaftFlow(self.network, self.iterations, self.side, self.reduction(height, width))

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the flow [H W 2] px."""
        with torch.no_grad():
            out = self.tensor(rgb_a, rgb_b)
        return out[0].permute(1, 2, 0).cpu().numpy()

    def tensor(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> torch.Tensor:
        """Return the flow [1 2 H W] px, with gradients."""
        height, width = rgb_a.shape[:2]
        factor = self.factor or self.reduction(height, width)
        small = (max(1, round(width / factor)), max(1, round(height / factor)))
        device = next(self.network.parameters()).device
        a, b = (
            padded(unit_range(np.asarray(cv2.resize(image, small, interpolation=cv2.INTER_AREA),
                                         np.uint8)), raft.RAFT_MULTIPLE).to(device)
            for image in (rgb_a, rgb_b)
        )
        flow = self.network(a, b, self.iterations).fine[..., : small[1], : small[0]]
        full = F.interpolate(flow, size=(height, width), mode="bilinear", align_corners=False)
        by = torch.tensor([width / small[0], height / small[1]], device=device)
        return full * by[:, None, None]

    def reduction(self, height: int, width: int) -> float:
        """Return the factor by which images of a size are reduced."""
        return max(1.0, min(height, width) / self.side)


def load_flownet2(checkpoint: Path, device: str = "auto") -> FlowNet2Flow:
    """Load the flow of `FlowNet2_checkpoint.pth.tar`, about 270 GFLOP for 640 x 480 pixels.

    Raises:
        ConfigError: If the file is missing or holds another network's weights.
    """
    with torch.device("meta"):  # saves the initialization of weights that are replaced
        network = flownet2.FlowNet2()
    weights = read_weights(checkpoint, network.state_dict(), "FlowNet2")
    network.load_state_dict(weights, assign=True)
    return FlowNet2Flow(network.to(device_named(device)).eval())


class FlowNet2Flow:
    """The flow of a `FlowNet2` network on images of any size."""

    rate = 5e-7
    """Learning rate at which it is tuned to a video (Sec. 4.1)"""

    def __init__(self, network: flownet2.FlowNet2) -> None:
        self.network = network

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the flow [H W 2] px."""
        with torch.no_grad():
            out = self.tensor(rgb_a, rgb_b)
        return out[0].permute(1, 2, 0).cpu().numpy()

    def tensor(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> torch.Tensor:
        """Return the flow [1 2 H W] px, with gradients."""
        height, width = rgb_a.shape[:2]
        place = next(self.network.parameters()).device
        a, b = (padded(unit_range(image), flownet2.FLOWNET2_MULTIPLE).to(place)
                for image in (rgb_a, rgb_b))
        return self.network(a, b)[..., :height, :width]
