"""The network of `raft.py` as a flow: weights from a file, images of any size."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..networks.raft import MULTIPLE, Raft
from ..networks.torch_runtime import F, device_named, padded, torch, unit
from ..networks.weights import read_weights

SHIPPED = Path(__file__).parents[1] / "weights" / "raft.safetensors"
_SIDE = 320
"""Pixels of the smaller side; larger images are reduced to this. Of what it was trained at, 0.75 to
1.6 times 240, here it errs least."""


def raft_flow(
    weights: Path = SHIPPED, device: str = "auto", iterations: int = 6, side: int = _SIDE
) -> RaftFlow:
    """The flow with the weights of a file; default: those that come with gcbench.

    Images are reduced to `side` px, the smaller of their sides.

    Raises GcbenchError if there is no such file or it is of another network.
    """
    network = Raft()
    network.load_state_dict(read_weights(weights, network.state_dict(), "raft"))
    return RaftFlow(network.to(device_named(device)), iterations, side)


class RaftFlow:
    """The network at a resolution that it knows, its flow enlarged to that of the images."""

    rate = 1e-4
    """At which it is tuned to a video."""

    def __init__(
        self, network: Raft, iterations: int = 6, side: int = _SIDE, factor: float = 0
    ) -> None:
        """`factor`: how much smaller it sees images; default: so much that `side` px are left."""
        self.network = network.eval()
        self.iterations, self.side, self.factor = iterations, side, factor

    def for_cuts_of(self, height: int, width: int) -> RaftFlow:
        """The same for cuts of images of that size, which it sees as small as whole ones."""
        return RaftFlow(self.network, self.iterations, self.side, self.reduction(height, width))

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """[H W 2] px."""
        with torch.no_grad():
            out = self.tensor(rgb_a, rgb_b)
        return out[0].permute(1, 2, 0).cpu().numpy()

    def tensor(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> torch.Tensor:
        """[1 2 H W] px, with gradients."""
        height, width = rgb_a.shape[:2]
        factor = self.factor or self.reduction(height, width)
        small = (max(1, round(width / factor)), max(1, round(height / factor)))
        device = next(self.network.parameters()).device
        a, b = (
            padded(unit(np.asarray(cv2.resize(image, small, interpolation=cv2.INTER_AREA),
                                   np.uint8)), MULTIPLE).to(device)
            for image in (rgb_a, rgb_b)
        )
        flow = self.network(a, b, self.iterations).fine[..., : small[1], : small[0]]
        full = F.interpolate(flow, size=(height, width), mode="bilinear", align_corners=False)
        by = torch.tensor([width / small[0], height / small[1]], device=device)
        return full * by[:, None, None]

    def reduction(self, height: int, width: int) -> float:
        """How much smaller the network sees images of that size."""
        return max(1.0, min(height, width) / self.side)
