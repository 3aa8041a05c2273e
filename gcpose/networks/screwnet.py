"""ScrewNet (Jain et al., ICRA 2021): the screw motion of one joint from depth video.

Features of each depth image by a ResNet-18, a memory over the frames, and a head that gives a screw
for each frame after the first: l and m = p x l of the axis (camera frame at the first frame), the
turn theta about it and the slide d along it since the first frame. At width 64 the sizes are those
of the paper; a smaller width makes all layers narrower.
"""

# pyright: basic
from __future__ import annotations

from .depth_video import DepthVideoNetwork
from .torch_runtime import Tensor, nn

SCREW_NUMBERS = 8
"""l (3), m (3), theta, d."""


class ScrewNet(DepthVideoNetwork):
    """The network; about 21 million parameters at width 64."""

    def __init__(self, width: int = 64) -> None:
        super().__init__(width)
        size, half, quarter = (n * width // 64 for n in (1000, 512, 256))
        self.reduced = _stack(size, half)
        self.restored = nn.Linear(half, size)
        self.memory = nn.LSTM(size, size, batch_first=True)
        self.head = nn.Sequential(
            *_stack(size, quarter), *_stack(quarter, quarter // 2),
            nn.Linear(quarter // 2, SCREW_NUMBERS))

    def motion(self, features: Tensor) -> Tensor:
        """Return the screws [B T-1 8] of videos with these features [B T F] of their images."""
        x = self.restored(self.reduced(features.flatten(0, 1))).unflatten(0, features.shape[:2])
        x = self.memory(x)[0].flatten(0, 1)
        return self.head(x).unflatten(0, features.shape[:2])[:, 1:]


def _stack(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, outputs), nn.BatchNorm1d(outputs), nn.ReLU())
