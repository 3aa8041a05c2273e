"""Training of `DustNet`."""

# pyright: basic
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import cast

from ...errors import DatasetError
from ..networks.depth_video import DepthVideoNetwork
from ..networks.dustnet import DustNet, ScrewDistribution, log_normalizer
from ..networks.torch_runtime import Tensor, torch
from .config import DustNetTraining
from .screwnet_task import ScrewNetTask


@dataclass(frozen=True)
class DustNetTask(ScrewNetTask):
    """Errors are those of the likeliest screws, as ScrewNet's; the loss is that of DUST-net."""

    config: DustNetTraining
    name: str = "dustnet"

    def make_network(self) -> DepthVideoNetwork:
        return DustNet(self.config.width, self.config.frames)

    def frames_of(self, folder: Path) -> int:
        """Return the network's number of frames. Raises DatasetError if the videos are shorter."""
        found = super().frames_of(folder)
        if found < self.config.frames:
            raise DatasetError(f"{folder}: its videos have {found} frames; this network needs "
                               f"{self.config.frames} (--frames)")
        return found

    def criterion(self, network: DepthVideoNetwork, output: Tensor, true: Tensor) -> Tensor:
        return distribution_loss(cast("DustNet", network).distribution(output), true)

    def screws(self, network: DepthVideoNetwork, output: Tensor) -> Tensor:
        return cast("DustNet", network).distribution(output).screws()


def distribution_loss(found: ScrewDistribution, true: Tensor) -> Tensor:
    """Return DUST-net's loss (the last of its three stages) for screws [B K 8], the mean over B.

    The negative logarithms of the likelihoods of |m|, theta and d, summed over the K frames, and
    the mean over the frames of that of the directions of l and m. A slide has m = 0: its directions
    have the likelihood of l alone.
    """
    l, m = true[..., :3], true[..., 3:6]
    length = m.norm(dim=-1)
    directions = torch.stack([l, m / length.clamp(min=1e-6)[..., None]], -1)
    agreement = (found.parameter[:, None] * directions).sum((-1, -2))
    loss = log_normalizer(found.parameter) - agreement.mean(1)
    for mean, precision, value in (
        (found.moment[:, None], found.moment_precision, length),
        (found.turn, found.turn_precision, true[..., 6]),
        (found.slide, found.slide_precision, true[..., 7]),
    ):
        error = (precision[:, None] * (mean - value)).square().sum(1) / 2
        loss = loss + error - value.shape[1] * precision.log()
    return loss.mean()
