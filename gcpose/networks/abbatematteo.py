"""The network of Abbatematteo, Tellex and Konidaris (CoRL 2019): a joint in one depth image.

Features of the image by a ResNet-18, and a mixture of Gaussians over the 22 numbers that describe
an object with one joint. At width 64 the sizes are those of the authors' code; a smaller width
makes all layers narrower.
"""

# pyright: basic
from __future__ import annotations

import math
from collections.abc import Mapping

from .resnet import ResNet18
from .torch_runtime import F, Tensor, nn, torch

AXIS, CONFIGURATION, RADIUS, GEOMETRY, POSE = (
    slice(0, 7), 7, slice(8, 11), slice(11, 15), slice(15, 22))
"""Places of the numbers (see `gcpose.training.joint_images`)."""
JOINT_NUMBERS = 22
_COMPONENTS = 20
_LEAST_DEVIATION = 0.1  # of the range of a number; smaller ones drown what is harder to see


class MixtureDensityNetwork(nn.Module):
    """The network; it knows the range of each number, to which its output is normalised."""

    bounds: Tensor
    """[2 22] least and greatest values in the training data"""

    def __init__(self, width: int = 64, dropout: float = 0.5) -> None:
        super().__init__()
        size, hidden = (n * width // 64 for n in (1000, 256))
        self.encoder = ResNet18(width)
        self.features = nn.Linear(8 * width, size)
        self.hidden = nn.Sequential(nn.Dropout(dropout), nn.Linear(size, hidden), nn.Tanh())
        self.weight = nn.Linear(hidden, _COMPONENTS)
        self.mean = nn.Linear(hidden, _COMPONENTS * JOINT_NUMBERS)
        self.deviation = nn.Linear(hidden, _COMPONENTS * JOINT_NUMBERS)
        self.register_buffer("bounds", torch.zeros(2, JOINT_NUMBERS))

    def forward(self, depth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return log weights [B 20], means and deviations [B 20 22], normalised, of images.

        `depth` [B H W] is as `depth_images.fit_depth` gives it.
        """
        images = depth[:, None].expand(-1, 3, -1, -1)
        x = self.encoder(images)[-1].mean((2, 3))
        with torch.autocast(x.device.type, enabled=False):  # small deviations, and ranges of 1
            x = self.hidden(self.features(x.float()))
            weight, mean, deviation = self.weight(x), self.mean(x), self.deviation(x)
        shape = (_COMPONENTS, JOINT_NUMBERS)
        deviation = F.elu(deviation) + 1 + _LEAST_DEVIATION
        return weight.log_softmax(-1), mean.unflatten(1, shape), deviation.unflatten(1, shape)

    def likeliest(self, depth: Tensor) -> Tensor:
        """Return the mean [B 22] of the heaviest component of images [B H W], with units."""
        weight, mean, _ = self(depth)
        heaviest = mean[torch.arange(len(depth)), weight.argmax(-1)]
        return self.bounds[0] + heaviest * (self.bounds[1] - self.bounds[0])

    def loss(self, depth: Tensor, numbers: Tensor, gain: float = 1.0) -> Tensor:
        """Return the mean negative log-likelihood of the numbers [B 22] of images [B H W].

        A number that is the same in all training data has no part in it. `gain` multiplies the
        gradient of the components' weights, which that of the means may drown.
        """
        weight, mean, deviation = self(depth)
        weight = gain * weight - (gain - 1) * weight.detach()
        range_ = self.bounds[1] - self.bounds[0]
        varies = range_ > 1e-6
        there = ((numbers - self.bounds[0]) / range_.clamp(min=1e-6))[:, None]
        square = ((there - mean) / deviation) ** 2
        density = -0.5 * square - deviation.log() - 0.5 * math.log(2 * math.pi)
        return -(weight + (density * varies).sum(-1)).logsumexp(-1).mean()


def mixture_width(tensors: Mapping[str, Tensor]) -> int:
    """Return the width of the network that has these tensors; 0 if it is none."""
    first = tensors.get("encoder.conv1.weight")
    return 0 if first is None or first.ndim != 4 or "mean.bias" not in tensors else len(first)
