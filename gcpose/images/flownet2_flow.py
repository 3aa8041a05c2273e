"""FlowNet2 as a flow, from the official checkpoint."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..networks.flownet2 import MULTIPLE, FlowNet2
from ..networks.torch_runtime import device_named, padded, torch, unit
from ..networks.weights import read_weights
from .flow_types import Flow


def flownet2_flow(checkpoint: Path, device: str = "auto") -> Flow:
    """The flow of `FlowNet2_checkpoint.pth.tar`, about 270 GFLOP for 640 x 480 pixels.

    Raises GcbenchError if there is no such file or it is of another network.
    """
    with torch.device("meta"):  # no time for random weights that are replaced
        network = FlowNet2()
    weights = read_weights(checkpoint, network.state_dict(), "FlowNet2")
    network.load_state_dict(weights, assign=True)
    return FlowNet2Flow(network.to(device_named(device)).eval())


class FlowNet2Flow:
    """The network on images of any size."""

    rate = 5e-7
    """At which it is tuned to a video (Sec. 4.1)."""

    def __init__(self, network: FlowNet2) -> None:
        self.network = network

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """[H W 2] px."""
        with torch.no_grad():
            out = self.tensor(rgb_a, rgb_b)
        return out[0].permute(1, 2, 0).cpu().numpy()

    def tensor(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> torch.Tensor:
        """[1 2 H W] px, with gradients."""
        height, width = rgb_a.shape[:2]
        place = next(self.network.parameters()).device
        a, b = (padded(unit(image), MULTIPLE).to(place) for image in (rgb_a, rgb_b))
        return self.network(a, b)[..., :height, :width]
