"""What a training run is told of the network that it trains."""

# pyright: basic
from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

from ...renderer.types import Meta
from ..networks.torch_runtime import Tensor, nn, torch
from ..networks.weights import read_weights
from .config import CravesTraining, ObjectTraining, TrainConfig
from .data import PlannedDataset
from .limits import check_numbers

Scores = dict[str, dict[str, float]]
"""Errors on held-out data: by the name of what was measured, and of the metric."""


def reduce_precision(config: TrainConfig, device: torch.device) -> torch.autocast:
    """Return the context in which a network computes in training."""
    reduced = config.precision == "bfloat16" or (
        config.precision == "auto" and has_bfloat16(device.type))
    return torch.autocast(device.type, torch.bfloat16, enabled=reduced)


def has_bfloat16(device: str) -> bool:
    """Return whether a device, such as "cpu", has instructions for bfloat16."""
    if device == "cuda":
        return torch.cuda.is_bf16_supported()
    instructions = "_is_avx512_bf16_supported", "_is_amx_tile_supported"  # not in early versions
    return device == "cpu" and any(
        getattr(torch.cpu, name, lambda: False)() for name in instructions)


class Samples(Protocol):
    """What is learned from."""

    def __len__(self) -> int:
        """Return the number of different samples."""
        ...

    def sample(self, number: int) -> Any:
        """Return sample `number` of any size, always the same: a dataclass of arrays."""
        ...


@dataclass(frozen=True)
class TrainingTask(ABC):
    """A network, its data and its loss; `training.loop.train` does the rest."""

    config: TrainConfig
    name: str = ""
    """Of the network, and of its file of weights."""
    unit: str = ""
    """Of the errors on held-out data."""
    units: ClassVar[Mapping[str, str]] = {}
    """The same, by the name of the metric, for the headings of curves."""

    def check_options(self) -> None:
        """Raise ConfigError if options are out of range, or do not fit the network."""
        check_numbers(self.config)

    def notes(self) -> Mapping[str, str]:
        """Return what the file of weights says about itself."""
        return {}

    @abstractmethod
    def make_network(self) -> nn.Module:
        """Return the untrained network."""

    def load_start(self, network: nn.Module, path: Path) -> None:
        """Load the weights with which a new run begins.

        Raises:
            ConfigError: If the file has none of this network.
        """
        network.load_state_dict(read_weights(path, network.state_dict(), self.name))

    def make_optimizer(self, network: nn.Module) -> torch.optim.Optimizer:
        """Return AdamW, or what the authors of a network used."""
        return torch.optim.AdamW(network.parameters(), self.config.rate, (0.9, 0.99),
                                 weight_decay=self.config.weight_decay)

    @abstractmethod
    def plan_data(self) -> Iterator[PlannedDataset]:
        """Yield the datasets to render if none are given."""

    def describe_misfit(self, meta: Meta) -> str:
        """Return why the network cannot learn from a sequence, as "has ..."; "" if it can."""
        return ""

    @abstractmethod
    def open_samples(self, folders: list[Path], network: nn.Module) -> Samples:
        """Return the samples of datasets."""

    def take_ranges(self, network: nn.Module, samples: Samples) -> None:  # noqa: B027
        """Give a network that has made no steps what it keeps of the ranges of the data."""

    def count_steps(self, samples: Samples) -> int:
        """Return the number of steps."""
        c = self.config
        if c.steps < 0 and isinstance(c, ObjectTraining | CravesTraining):
            return -(-c.epochs * len(samples) // c.batch)
        return c.steps

    @abstractmethod
    def rate(self, progress: float) -> float:
        """Return the learning rate after a share of the steps."""

    @abstractmethod
    def loss(self, network: nn.Module, batch: list[Tensor], progress: float) -> Tensor:
        """Return the loss of a batch, in training."""

    @abstractmethod
    def measure(self, network: nn.Module, folder: Path) -> Scores:
        """Return the errors on a held-out dataset."""
