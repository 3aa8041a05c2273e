"""The stacked hourglass (Newell et al., ECCV 2016) of CRAVES: heat maps of keypoints in a crop.

Each of two stacks reduces its features four times by 2, restores them, and returns a map for each
keypoint; the second gets the features and the maps of the first. At width 256 the sizes are those
of CRAVES (Zuo et al., CVPR 2019); a smaller width makes all layers narrower.
"""

# pyright: basic
from __future__ import annotations

from collections.abc import Mapping

from .torch_runtime import F, Tensor, nn, torch

KEYPOINTS = 17
"""Heat maps: the keypoints of the OWI-535."""
_DEPTH = 4
_STACKS = 2


class StackedHourglass(nn.Module):
    """The network; about 6.7 million parameters at width 256."""

    def __init__(self, width: int = 256) -> None:
        """`width`: channels of the hourglasses, a multiple of 16."""
        super().__init__()
        self.stem = nn.Sequential(
            nn.Conv2d(3, width // 4, 7, 2, 3), nn.BatchNorm2d(width // 4), nn.ReLU(),
            _Residual(width // 4, width // 2), nn.MaxPool2d(2),
            _Residual(width // 2, width), _Residual(width, width))
        self.hourglass = nn.ModuleList(_Hourglass(width, _DEPTH) for _ in range(_STACKS))
        self.features = nn.ModuleList(
            nn.Sequential(_Residual(width, width), nn.Conv2d(width, width, 1),
                          nn.BatchNorm2d(width), nn.ReLU()) for _ in range(_STACKS))
        self.maps = nn.ModuleList(nn.Conv2d(width, KEYPOINTS, 1) for _ in range(_STACKS))
        self.from_features = nn.Conv2d(width, width, 1)
        self.from_maps = nn.Conv2d(KEYPOINTS, width, 1)
        # the order that convolutions in bfloat16 compute in
        self.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    def forward(self, image: Tensor) -> list[Tensor]:
        """Return the heat maps [B 17 H/4 W/4] of both stacks of images [B 3 H W] in 0..1."""
        x, out = self.stem(image - 0.5), []
        for k in range(_STACKS):
            features = self.features[k](self.hourglass[k](x))
            out.append(self.maps[k](features))
            if k + 1 < _STACKS:
                x = x + self.from_features(features) + self.from_maps(out[-1])
        return out


class _Hourglass(nn.Module):
    def __init__(self, width: int, depth: int) -> None:
        super().__init__()
        self.beside, self.before, self.after = (_Residual(width, width) for _ in range(3))
        self.inner = _Hourglass(width, depth - 1) if depth > 1 else _Residual(width, width)

    def forward(self, x: Tensor) -> Tensor:
        low = self.after(self.inner(self.before(F.max_pool2d(x, 2))))
        return self.beside(x) + F.interpolate(low, scale_factor=2)


class _Residual(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        half = outputs // 2
        self.steps = nn.Sequential(
            nn.BatchNorm2d(inputs), nn.ReLU(), nn.Conv2d(inputs, half, 1),
            nn.BatchNorm2d(half), nn.ReLU(), nn.Conv2d(half, half, 3, 1, 1),
            nn.BatchNorm2d(half), nn.ReLU(), nn.Conv2d(half, outputs, 1))
        self.around = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        return self.around(x) + self.steps(x)


def hourglass_width(tensors: Mapping[str, Tensor]) -> int:
    """Return the width of the network that has these tensors; 0 if it is none."""
    last = tensors.get("from_features.weight")
    return 0 if last is None or last.ndim != 4 else int(last.shape[0])
