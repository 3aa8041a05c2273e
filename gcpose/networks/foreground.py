"""A small network for what moves in a video of a still camera: a U-Net that sees all frames.

Each frame is encoded alone. At every level but the first, a frame also gets the mean and the
maximum of the features over all frames: an object may hide its background in most of them.
`gcpose.images.foreground_network` computes the same without PyTorch.
"""

# pyright: basic
from __future__ import annotations

from itertools import pairwise

from .torch_runtime import F, Tensor, nn, torch

FOREGROUND_WIDTHS = (16, 32, 64, 96)
"""Channels at 1/2, 1/4, 1/8 and 1/16 of the resolution."""


class ForegroundNet(nn.Module):
    """The network; about 0.4 million parameters."""

    def __init__(self, channels: int) -> None:
        """`channels`: those of a frame."""
        super().__init__()
        widths = FOREGROUND_WIDTHS
        inputs = (4 * channels, *widths[:-1])
        self.enter = nn.ModuleList(
            _Step(a, b, stride=2 if k else 1)
            for k, (a, b) in enumerate(zip(inputs, widths, strict=True)))
        self.encode = nn.ModuleList(_Step(w, w) for w in widths)
        self.exchange = nn.ModuleList(_Step(3 * w, w, side=1) for w in widths[1:])
        self.bottom = _Step(widths[-1], widths[-1])
        self.rise = nn.ModuleList(_Step(below, own, side=1) for own, below in pairwise(widths))
        self.decode = nn.ModuleList(_Step(w, w) for w in widths[:-1])
        self.out = nn.Conv2d(widths[0], 4, 3, padding=1)
        # the order that convolutions in bfloat16 compute in
        self.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    def forward(self, frames: Tensor) -> Tensor:
        """Return logits [B T S S] of frames [B T C S S]; S is a multiple of 16."""
        batch, count = frames.shape[:2]
        x = F.pixel_unshuffle(frames.flatten(0, 1), 2)
        x = x.contiguous(memory_format=torch.channels_last)
        levels: list[Tensor] = []
        for k, (enter, encode) in enumerate(zip(self.enter, self.encode, strict=True)):
            x = encode(enter(x))
            if k:
                whole = x.unflatten(0, (batch, count))
                over = [whole.mean(1, keepdim=True), whole.amax(1, keepdim=True)]
                shared = [o.expand_as(whole).flatten(0, 1) for o in over]
                x = self.exchange[k - 1](torch.cat([x, *shared], 1))
            levels.append(x)
        x = self.bottom(x)
        for k in reversed(range(len(levels) - 1)):
            x = levels[k] + F.interpolate(self.rise[k](x), scale_factor=2)
            x = self.decode[k](x)
        return F.pixel_shuffle(self.out(x), 2)[:, 0].unflatten(0, (batch, count))


class _Step(nn.Module):
    def __init__(self, inputs: int, outputs: int, side: int = 3, stride: int = 1) -> None:
        super().__init__()
        self.filter = nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False)
        self.norm = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(self.norm(self.filter(x)))
