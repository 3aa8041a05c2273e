"""Training of the network of the foreground."""

# pyright: basic
from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ...renderer.dataset import open_dataset
from ...renderer.scene import RenderConfig
from ...robots.appliances import CATEGORIES
from ..images import (
    FOREGROUND_CHANNELS,
    Foreground,
    ForegroundInference,
    ImageSettings,
    LearnedForeground,
    WeightReader,
    subtract_background,
)
from ..networks.foreground import ForegroundNet
from ..networks.torch_runtime import F, Tensor, nn
from .config import ForegroundTraining
from .data import PlannedDataset
from .flow_task import one_cycle
from .foreground_videos import ForegroundVideos, true_foreground
from .task import Samples, Scores, TrainingTask, reduce_precision

_WARM_UP, _FIRST_RATE = 0.05, 0.05
_SEQUENCES = 4  # of each random object


@dataclass(frozen=True)
class ForegroundTask(TrainingTask):
    """Errors are measured beside those of the foreground by the usual color."""

    config: ForegroundTraining
    name: str = "foreground"
    unit: str = "iou: %, a mean over the sequences; worst: that of the worst tenth of them"
    units: ClassVar[Mapping[str, str]] = {"iou": "%", "worst": "%"}

    def make_network(self) -> nn.Module:
        return ForegroundNet(FOREGROUND_CHANNELS)

    def plan_data(self) -> Iterator[PlannedDataset]:
        """Yield datasets of appliances and of random objects, and those to measure errors on."""
        c = self.config
        first = 1000 * c.seed
        for k, category in enumerate(CATEGORIES):
            yield _plan(category, first + k, c.appliances)
            yield _plan(category, first + 50 + k, c.held_out_sequences, held_out=True)
        for k in range(c.models):
            yield _plan(f"random:{first + 100 + k}", first + 100 + k, _SEQUENCES)
        yield _plan(f"random:{first + 99}", first + 99, c.held_out_sequences, held_out=True)

    def open_samples(self, folders: list[Path], network: nn.Module) -> Samples:
        return ForegroundVideos(folders, self.config)

    def rate(self, progress: float) -> float:
        return self.config.rate * one_cycle(progress, _WARM_UP, _FIRST_RATE)

    def loss(self, network: nn.Module, batch: list[Tensor], progress: float) -> Tensor:
        """Return the cross-entropy and one minus the overlap of each video."""
        frames, moving = batch
        with reduce_precision(self.config, frames.device):
            logits = network(frames)
        logits = logits.float()
        found = logits.sigmoid()
        both, either = ((found * moving).sum((1, 2, 3)), (found + moving).sum((1, 2, 3)))
        overlap = (2 * both + 1) / (either + 1)
        return F.binary_cross_entropy_with_logits(logits, moving) + 0.3 * (1 - overlap).mean()

    def inference(self, network: nn.Module) -> ForegroundInference:
        """Return the network as it is in use."""
        tensors = {k: v.detach().float().cpu().numpy() for k, v in network.state_dict().items()}
        return ForegroundInference(WeightReader(tensors, "the network", self.name))

    def measure(self, network: nn.Module, folder: Path) -> Scores:
        """Return the overlap with the truth in whole images, of this network and without it."""
        settings = ImageSettings()
        learned = LearnedForeground(self.inference(network), settings)
        methods: dict[str, Foreground] = {
            "background": lambda rgb: subtract_background(rgb, settings), "network": learned}
        found: dict[str, list[float]] = {name: [] for name in methods}
        for sequence in open_dataset(folder):
            true = true_foreground(sequence, slice(None))
            rgb = np.asarray(sequence.rgb[:])
            for name, method in methods.items():
                mask = method(rgb)
                found[name].append(float((mask & true).sum() / max(1, (mask | true).sum())))
        return {name: {"iou": 100 * float(np.mean(v)), "worst": 100 * worst_tenth(v)}
                for name, v in found.items()}


def _plan(robot: str, seed: int, sequences: int, held_out: bool = False) -> PlannedDataset:
    config = RenderConfig(robot=robot, seed=seed, stream="train", width=320, height=240)
    return PlannedDataset(f"{robot.partition(':')[0]}-{seed}", config, sequences, held_out)


def worst_tenth(values: list[float]) -> float:
    """Return the mean of the smallest tenth."""
    return float(np.mean(sorted(values)[: -(-len(values) // 10)]))
