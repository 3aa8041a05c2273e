"""What the trainings on objects with one joint share: options, data and optimizer."""

# pyright: basic
from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ...errors import ConfigError
from ...renderer.dataset import open_dataset
from ...renderer.runtime import plural
from ...renderer.scene import RenderConfig
from ...renderer.types import Meta
from ...robots.appliances import CATEGORIES
from ...robots.geometry import DEPTH_HEIGHT
from ..networks.torch_runtime import nn, torch
from ..networks.weights import read_notes
from .config import ObjectTraining
from .data import PlannedDataset, find_datasets
from .task import TrainingTask

_IMAGE_WIDTH = DEPTH_HEIGHT * 4 // 3  # px: the whole image at the benchmark's aspect


@dataclass(frozen=True)
class ObjectTask(TrainingTask):
    """The part of a `TrainingTask` that does not depend on the network."""

    config: ObjectTraining
    unit: str = "deg, m"
    layers: tuple[str, ...] = ()
    """Optional truth that the network learns from."""

    def check_options(self) -> None:
        super().check_options()
        c = self.config
        if not 8 <= c.width <= 64 or c.width % 8:
            raise ConfigError(f"--width {c.width}: give a multiple of 8 from 8 to 64")
        if unknown := sorted(set(c.classes) - set(CATEGORIES)):
            raise ConfigError(f"--classes {unknown[0]}: there are {', '.join(CATEGORIES)}")
        if len(set(c.classes)) < len(c.classes):
            raise ConfigError(f"--classes {' '.join(c.classes)}: give each class once")
        if not c.classes:
            raise ConfigError(f"--classes: give one or more of {', '.join(CATEGORIES)}")

    def notes(self) -> Mapping[str, str]:
        """Return what the network has learned from, also before this run."""
        given = find_datasets(self.config.data)
        names = [open_dataset(f).config.robot for f in given] or self.config.classes
        objects = {Path(n.partition(":")[0]).stem for n in names}
        if self.config.start_from is not None and self.config.start_from.suffix == ".safetensors":
            objects |= {*read_notes(self.config.start_from).get("objects", "").split(", ")} - {""}
        return {"objects": ", ".join(sorted(objects))}

    def describe_misfit(self, meta: Meta) -> str:
        """Return what a sequence lacks: one scored joint, or a layer."""
        if len(meta.scored_joints) != 1:
            return (f"has {plural(len(meta.scored_joints), 'scored joint')}; {self.name} learns "
                    "from objects with one")
        lacking = [layer for layer in self.layers if layer not in meta.layers]
        return f"has no {lacking[0]}; render with --layers {lacking[0]}" if lacking else ""

    def make_optimizer(self, network: nn.Module) -> torch.optim.Optimizer:
        return torch.optim.Adam(network.parameters(), self.config.rate,
                                weight_decay=self.config.weight_decay)

    def rate(self, progress: float) -> float:
        """Return the learning rate: constant, and as a cosine to 0 in the last share of steps."""
        share = self.config.rate_decay
        fallen = max(0.0, 1 - (1 - progress) / share) if share else 0.0
        return self.config.rate * (1 + math.cos(math.pi * fallen)) / 2

    def plan_data(self) -> Iterator[PlannedDataset]:
        """Yield a dataset of each class, and one to measure errors on."""
        c = self.config
        for k, category in enumerate(c.classes):
            for held_out, count in ((False, c.sequences), (True, c.held_out_sequences)):
                seed = 1000 * c.seed + 10 * CATEGORIES.index(category) + held_out
                render = RenderConfig(robot=category, seed=seed, twin_of="", stream="train",
                                      frames=c.frames, width=_IMAGE_WIDTH, height=DEPTH_HEIGHT,
                                      layers=self.layers)
                own = len(range(k, count, len(c.classes)))
                name = f"{category}-{seed}"
                yield PlannedDataset(name, render, max(1, own), held_out)
