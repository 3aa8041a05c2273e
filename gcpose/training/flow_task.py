"""Training of the flow network `Raft`."""

# pyright: basic
from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from ...errors import ConfigError
from ..images import dis_flow, fine_dis_flow
from ..images.network_flow import RaftFlow
from ..networks.raft import Raft
from ..networks.torch_runtime import Tensor, nn
from .config import FlowTraining
from .data import PlannedDataset, plan_datasets
from .errors import FlowErrors, flow_errors
from .loss import flow_loss
from .pairs import FramePair, Pairs
from .task import Samples, Scores, TrainingTask, reduce_precision


@dataclass(frozen=True)
class FlowTask(TrainingTask):
    """Errors are measured beside those of the flows that do not learn."""

    config: FlowTraining
    name: str = "raft"
    unit: str = "px on moving parts"
    units: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("epe", "median", "bias", "bias_by_size", "speed"), "px")
    _checks: dict[Path, HeldOutPairs] = field(default_factory=dict)

    def check_options(self) -> None:
        super().check_options()
        crop = self.config.crop
        if crop[0] % 16 or crop[1] % 16:
            raise ConfigError(f"--crop {crop[0]} {crop[1]}: give multiples of 16")

    def make_network(self) -> nn.Module:
        return Raft()

    def plan_data(self) -> Iterator[PlannedDataset]:
        c = self.config
        return plan_datasets(c.models, c.seed, c.robots, c.recipe)

    def open_samples(self, folders: list[Path], network: nn.Module) -> Samples:
        return Pairs(folders, self.config)

    def rate(self, progress: float) -> float:
        c = self.config
        return c.rate * one_cycle(progress, c.warm_up, c.first_rate)

    def loss(self, network: nn.Module, batch: list[Tensor], progress: float) -> Tensor:
        a, b, flow, part, weight = batch
        with reduce_precision(self.config, a.device):
            out = network(a, b, self.config.iterations)
        return flow_loss(out, flow, part, weight, progress, self.config.loss)

    def measure(self, network: nn.Module, folder: Path) -> Scores:
        """Return the errors of all flows on the same pairs."""
        if folder not in self._checks:
            self._checks[folder] = HeldOutPairs.choose(folder, self.config.held_out_pairs)
        check = self._checks[folder]
        learned = flow_errors({"raft": RaftFlow(network)}, check.pairs)  # type: ignore[arg-type]
        return {name: asdict(e) for name, e in {**check.classical, **learned}.items()}


@dataclass(frozen=True)
class HeldOutPairs:
    """Pairs of a held-out dataset, and the errors of the flows that do not learn."""

    pairs: list[FramePair]
    classical: dict[str, FlowErrors]

    @staticmethod
    def choose(folder: Path, most: int) -> HeldOutPairs:
        """Choose at most `most` forward pairs, evenly over the dataset."""
        found = Pairs([folder], FlowTraining())
        count = min(most, len(found) // 2)
        chosen = np.linspace(0, len(found) // 2 - 1, count).astype(int)
        pairs = [found.pair(2 * int(i)) for i in chosen]
        return HeldOutPairs(pairs, flow_errors({"dis": dis_flow, "dis-fine": fine_dis_flow}, pairs))


def one_cycle(progress: float, warm_up: float, first: float) -> float:
    """Return the learning rate as a share of the highest.

    It rises linearly from `first` until the share `warm_up` of the training, then falls to 0
    (after Smith and Topin, 2019).
    """
    if progress < warm_up:
        return first + (1.0 - first) * progress / warm_up
    return max(0.0, (1.0 - progress) / (1.0 - warm_up))
