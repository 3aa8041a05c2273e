"""Training of `ScrewNet`."""

# pyright: basic
from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import ConfigError
from ...renderer.dataset import open_dataset
from ...renderer.scene import RenderConfig
from ...robots.appliances import CATEGORIES
from ..networks.screwnet import DEPTH_HEIGHT, ScrewNet
from ..networks.torch_runtime import Tensor, nn, torch
from .config import ScrewNetTraining
from .data import PlannedDataset, find_datasets
from .screws import DepthVideos, line_distance, screw_loss
from .task import Samples, Scores

_IMAGE_WIDTH = DEPTH_HEIGHT * 4 // 3  # px: the whole image at the benchmark's aspect


@dataclass(frozen=True)
class ScrewNetTask:
    """Errors are measured beside those of no motion at all."""

    config: ScrewNetTraining
    name: str = "screwnet"
    unit: str = "deg, m"

    def check_options(self) -> None:
        c = self.config
        if not 8 <= c.width <= 64 or c.width % 8:
            raise ConfigError(f"--width {c.width}: give a multiple of 8 from 8 to 64")
        if unknown := sorted(set(c.classes) - set(CATEGORIES)):
            raise ConfigError(f"--classes {unknown[0]}: there are {', '.join(CATEGORIES)}")
        if c.steps < -1 or c.epochs < 1 or c.frames < 2 or not c.classes:
            raise ConfigError("--epochs must be 1 or more, --frames 2 or more")
        if not 0 <= c.dropped < 1:
            raise ConfigError(f"--dropped {c.dropped}: give a share from 0 to 1")

    def notes(self) -> Mapping[str, str]:
        """Return what the network has learned from."""
        given = find_datasets(self.config.data)
        names = [open_dataset(f).config.robot for f in given] or self.config.classes
        return {"objects": ", ".join(sorted({Path(n.partition(":")[0]).stem for n in names}))}

    def make_network(self) -> nn.Module:
        return ScrewNet(self.config.width)

    def make_optimizer(self, network: nn.Module) -> torch.optim.Optimizer:
        return torch.optim.Adam(network.parameters(), self.config.rate,
                                weight_decay=self.config.weight_decay)

    def plan_data(self) -> Iterator[PlannedDataset]:
        """Yield a dataset of each class, and one to measure errors on."""
        c = self.config
        for k, category in enumerate(c.classes):
            for held_out, count in ((False, c.sequences), (True, c.held_out_sequences)):
                seed = 1000 * c.seed + 10 * CATEGORIES.index(category) + held_out
                render = RenderConfig(robot=category, seed=seed, stream="train", frames=c.frames,
                                      width=_IMAGE_WIDTH, height=DEPTH_HEIGHT)
                own = len(range(k, count, len(c.classes)))
                name = f"{category}-{seed}"
                yield PlannedDataset(name, render, max(1, own), held_out)

    def open_samples(self, folders: list[Path]) -> Samples:
        return DepthVideos(folders, self.config.frames, self.config.seed, self.config.dropped)

    def count_steps(self, samples: Samples) -> int:
        c = self.config
        return c.steps if c.steps >= 0 else -(-c.epochs * len(samples) // c.batch)

    def rate(self, progress: float) -> float:
        """Return the learning rate: a tenth after each 30 % of the steps."""
        return self.config.rate * 0.1 ** int(progress / 0.3)

    def loss(self, network: nn.Module, batch: list[Tensor], progress: float) -> Tensor:
        depth, screw = batch
        return screw_loss(network(depth), screw)

    def measure(self, network: nn.Module, folder: Path) -> Scores:
        """Return the mean errors, and the mean motion: the error of an estimate of none."""
        frames = min(self.config.frames, open_dataset(folder).config.frames)
        videos = DepthVideos([folder], frames, self.config.seed, 0.0)
        device = next(network.parameters()).device
        rows: list[np.ndarray] = []
        with torch.no_grad():
            for number in range(len(videos)):
                sample = videos.sample(number)
                depth, true = (torch.from_numpy(x)[None].to(device) for x in vars(sample).values())
                found = network(depth)
                rows.append(_errors(found, true, float(screw_loss(found, true))))
        names = "angle", "slide", "direction", "line", "loss", "true angle", "true slide"
        mean: dict[str, float] = dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))
        still = {"angle": mean.pop("true angle"), "slide": mean.pop("true slide")}
        return {"screwnet": mean, "hold-still": still}


def _errors(found: Tensor, true: Tensor, loss: float) -> np.ndarray:
    """The means over frames of screws [1 K 8]: deg, m, deg, m, the loss, deg, m."""
    l = found[..., :3] / found[..., :3].norm(dim=-1, keepdim=True).clamp(min=1e-6)
    m = found[..., 3:6]
    angle = (found[..., 6] - true[..., 6]).abs().rad2deg()
    direction = (l * true[..., :3]).sum(-1).clamp(-1, 1).acos().rad2deg()
    line = line_distance(l, m, true[..., :3], true[..., 3:6])
    slide = (found[..., 7] - true[..., 7]).abs()
    values = [angle, slide, direction, line]
    return np.array([*(float(v.mean()) for v in values), loss,
                     float(true[..., 6].mean().rad2deg()), float(true[..., 7].mean())])
