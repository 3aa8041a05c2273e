"""DUST-net (Jain et al., CoRL 2021): a distribution of the screw motion of one joint.

Features of each depth image by a ResNet-18, and a head on those of all frames together. It gives
one axis: a matrix von Mises-Fisher distribution of the directions of l and m = p x l, and normal
ones of |m|, and of the turn and the slide since the first frame in each later one. At width 64 the
sizes are those of the paper; a smaller width makes all layers narrower.
"""

# pyright: basic
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .depth_video import DepthVideoNetwork
from .torch_runtime import F, Tensor, nn, torch

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)  # of integrals over -1 .. 1
_LEAST_PRECISION = 1e-3


@dataclass(frozen=True)
class ScrewDistribution:
    """Distributions of the motions in B videos of K + 1 frames."""

    parameter: Tensor
    """[B 3 2] of the matrix von Mises-Fisher distribution of the unit vectors along l and m"""
    moment: Tensor
    """[B] mean of |m|, m"""
    moment_precision: Tensor
    """[B] inverse of its standard deviation"""
    turn: Tensor
    """[B K] means of theta, rad"""
    turn_precision: Tensor
    """[B]"""
    slide: Tensor
    """[B K] means of d, m"""
    slide_precision: Tensor
    """[B]"""

    def screws(self) -> Tensor:
        """Return the likeliest screws [B K 8]: l, m, theta and d (see `networks.screwnet`)."""
        u, _, vh = torch.linalg.svd(self.parameter, full_matrices=False)
        l, along = (u @ vh).unbind(-1)
        axis = torch.cat([l, self.moment[:, None] * along], -1)[:, None]
        return torch.cat([axis.expand(-1, self.turn.shape[1], -1), self.turn[..., None],
                          self.slide[..., None]], -1)


class DustNet(DepthVideoNetwork):
    """The network; about 28 million parameters at width 64."""

    def __init__(self, width: int = 64, frames: int = 16) -> None:
        super().__init__(width)
        hidden = 1024 * width // 64
        self.frames = frames
        self.head = nn.Sequential(nn.Linear(frames * self.feature_count, hidden), nn.ReLU(),
                                  nn.Linear(hidden, 10 + 2 * (frames - 1)))

    def motion(self, features: Tensor) -> Tensor:
        """Return the numbers [B 40] of the distribution (see `distribution`), by features [B T F]
        of the images of videos of T frames, the number that the network has learned with."""
        return self.head(features.flatten(1))

    def distribution(self, numbers: Tensor) -> ScrewDistribution:
        """Return the distribution that the output stands for."""
        numbers = numbers.float()
        positive = F.softplus(numbers[:, 6:])
        k = self.frames - 1
        moment, turn, slide = positive.split([2, k + 1, k + 1], dim=1)
        means, precisions = zip(*((part[:, :-1], part[:, -1] + _LEAST_PRECISION)
                                  for part in (moment, turn, slide)), strict=True)
        return ScrewDistribution(
            numbers[:, :6].unflatten(1, (2, 3)).transpose(1, 2), means[0][:, 0], precisions[0],
            means[1], precisions[1], means[2], precisions[2])


def log_normalizer(parameter: Tensor) -> Tensor:
    """Return the logarithm [...] of the mean of exp(tr(F^T X)) over all X [3 2] of orthonormal
    columns, of parameters F [... 3 2]: 0F1(3/2; F^T F / 4).

    X and its third column are a rotation, so that this is the constant of a matrix Fisher
    distribution whose third singular value is 0: an integral over Bessel functions of the sum and
    the difference of the others (Lee, "Bayesian attitude estimation with the matrix Fisher
    distribution on SO(3)", 2018). The published code has a table in its place.
    """
    a, b = parameter.unbind(-1)
    square = parameter.square().sum((-1, -2))
    product = torch.linalg.cross(a, b).square().sum(-1).clamp(min=1e-12).sqrt()
    total = (square + 2 * product).sqrt()[..., None]
    difference = (square - 2 * product).clamp(min=1e-12).sqrt()[..., None]
    u, weight = (torch.as_tensor(x, dtype=parameter.dtype, device=parameter.device)
                 for x in (_NODES, _WEIGHTS))
    inner, outer = difference * (1 - u) / 2, total * (1 + u) / 2
    scaled = torch.special.i0e(inner) * torch.special.i0e(outer)
    scaled = scaled * (inner + outer - total).exp()
    return total[..., 0] + ((scaled * weight).sum(-1) / 2).log()


def recorded_frames(width: int, tensors: Mapping[str, Tensor]) -> int:
    """Return the number of frames that a `DustNet` of these tensors has learned with, or 0.

    The shape of the first layer of the head decides, so that a file of weights cannot ask for more
    memory than it has itself.
    """
    first = tensors.get("head.0.weight")
    if first is None or first.ndim != 2 or len(first) != 1024 * width // 64:
        return 0
    return first.shape[1] // (1000 * width // 64)
