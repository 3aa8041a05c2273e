"""`gcbench train flow`: training of the `Raft` network, from renders to weights."""

# pyright: basic
from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np

from ...errors import ConfigError, DatasetError, MethodError
from ...renderer.dataset import open_dataset
from ...robots.files import lock_folder
from ..images import dis_flow, fine_dis_flow
from ..images.network_flow import RaftFlow
from ..networks.raft import Raft
from ..networks.torch_runtime import device_named, torch
from ..networks.weights import Checkpoint, read_checkpoint, read_weights, write_checkpoint
from .config import TrainConfig
from .data import render_datasets
from .errors import FlowErrors, flow_errors
from .loss import flow_loss
from .pairs import Pairs


@dataclass(frozen=True)
class _Run:
    """What a run needs in each step."""

    config: TrainConfig
    network: Raft
    optimizer: torch.optim.Optimizer
    checks: list[HeldOutCheck]
    log: TextIO


def train(config: TrainConfig) -> dict[str, dict[str, FlowErrors]]:
    """Train until step `steps`; return the errors on each held-out dataset, by dataset and flow.

    Raises:
        ConfigError: If an option is out of range, or a file of weights does not fit.
        DatasetError: If a dataset is missing, has no pairs, or is of the stream "test".
        MethodError: If the loss diverges.
        RenderError: If this machine cannot render.
    """
    if config.crop[0] % 16 or config.crop[1] % 16 or min(config.crop) < 48:
        words = " ".join(map(str, config.crop))
        raise ConfigError(f"--crop {words}: give multiples of 16 from 48")
    if config.steps < 0 or config.batch < 1 or config.every < 1:
        raise ConfigError("--steps must be 0 or more, --batch and --every 1 or more")
    device = device_named(config.device)
    if config.threads:
        torch.set_num_threads(config.threads)
        cv2.setNumThreads(config.threads)
    torch.manual_seed(config.seed)
    network = Raft()
    if config.start_from is not None:
        network.load_state_dict(read_weights(config.start_from, network.state_dict(), "raft"))
    network.to(device)
    optimizer = torch.optim.AdamW(
        network.parameters(), config.rate, (0.9, 0.99), weight_decay=config.weight_decay)
    checks = [HeldOutCheck(path, config.held_out_pairs) for path in find_datasets(config.held_out)]
    given = find_datasets(config.data)
    refuse_test_streams(given)
    config.out.mkdir(parents=True, exist_ok=True)
    with lock_folder(config.out), (config.out / "log.jsonl").open("a") as log:
        run = _Run(config, network, optimizer, checks, log)
        at = read_checkpoint(config.out, network, optimizer)
        if at.step < config.steps:
            data = given or render_datasets(config.out / "data", config)
            at = _train_steps(run, Pairs(data, config), at)
        return _check(run, at)


def _train_steps(run: _Run, pairs: Pairs, at: Checkpoint) -> Checkpoint:
    """Train from a checkpoint until the last step; return the checkpoint there."""
    from tqdm import tqdm

    config, network = run.config, run.network
    started, saved = time.monotonic() - at.seconds, time.monotonic()
    step, mean = at.step, float("nan")
    bar = tqdm(total=config.steps, initial=step, unit="step", dynamic_ncols=True)
    try:
        for batch in _batches(pairs, config, step, next(network.parameters()).device):
            loss = _train_step(run, batch, step)
            step += 1
            mean = loss if np.isnan(mean) else 0.98 * mean + 0.02 * loss
            bar.update()
            at = Checkpoint(step, time.monotonic() - started)
            if step % 20 == 0:
                bar.set_postfix_str(f"loss {mean:.3f}")
                _write(run.log, {
                    "step": step, "seconds": round(at.seconds, 1), "loss": round(mean, 4)})
            if time.monotonic() - saved > 60 * config.minutes:
                write_checkpoint(config.out, network, run.optimizer, at)
                saved = time.monotonic()
            if step % config.every == 0 and step < config.steps:
                _check(run, at)
    finally:
        bar.close()
        if step > 0:
            write_checkpoint(config.out, network, run.optimizer, at)
    return at


def _train_step(run: _Run, batch: list[torch.Tensor], step: int) -> float:
    """Make a step of the optimizer; return the loss."""
    config, network = run.config, run.network
    a, b, flow, part, weight = batch
    kind = torch.bfloat16 if config.precision == "bfloat16" else torch.float32
    progress = step / config.steps
    for group in run.optimizer.param_groups:
        group["lr"] = config.rate * one_cycle(progress, config.warm_up, config.first_rate)
    with torch.autocast(a.device.type, kind, enabled=kind != torch.float32):
        out = network.train()(a, b, config.iterations)
    loss = flow_loss(out, flow, part, weight, progress, config.loss)
    run.optimizer.zero_grad(set_to_none=True)
    loss.backward()
    norm = torch.nn.utils.clip_grad_norm_(network.parameters(), config.max_gradient)
    if not torch.isfinite(norm):
        raise MethodError(f"training diverged at step {step}; lower --rate")
    run.optimizer.step()
    return loss.item()


class _NumberedSamples(torch.utils.data.Dataset[tuple[torch.Tensor, ...]]):
    """Samples by number, as tensors."""

    def __init__(self, pairs: Pairs) -> None:
        self.pairs = pairs

    def __getitem__(self, number: int) -> tuple[torch.Tensor, ...]:
        cv2.setNumThreads(1)
        s = self.pairs.sample(number)
        return tuple(torch.from_numpy(x) for x in (s.a, s.b, s.flow, s.part, s.weight))


def _batches(
    pairs: Pairs, config: TrainConfig, step: int, device: torch.device
) -> Iterator[list[torch.Tensor]]:
    """Batches from `step` on, the same after an interruption."""
    loader = torch.utils.data.DataLoader(
        _NumberedSamples(pairs),
        batch_size=config.batch,
        sampler=range(step * config.batch, config.steps * config.batch),
        num_workers=config.workers,
        multiprocessing_context="spawn" if config.workers else None,
        prefetch_factor=4 if config.workers else None,
    )
    for batch in loader:
        yield [tensor.to(device, non_blocking=True) for tensor in batch]


def one_cycle(progress: float, warm_up: float, first: float) -> float:
    """Return the learning rate as a share of the highest.

    It rises linearly from `first` until the share `warm_up` of the training, then falls to 0
    (after Smith and Topin, 2019).
    """
    if progress < warm_up:
        return first + (1.0 - first) * progress / warm_up
    return max(0.0, (1.0 - progress) / (1.0 - warm_up))


def find_datasets(paths: tuple[Path, ...]) -> list[Path]:
    """Return the datasets among paths, and those in paths that are none.

    Raises:
        DatasetError: If there is no dataset at a path.
    """
    out: list[Path] = []
    for path in paths:
        found = [path] if (path / "dataset.json").exists() else sorted(
            p.parent for p in path.glob("*/dataset.json"))
        if not found:
            raise DatasetError(f"{path}: there is no dataset; render one with `gcbench render`")
        out += found
    return out


def refuse_test_streams(paths: list[Path]) -> None:
    """Check that no dataset is of the stream that suites score on.

    Raises:
        DatasetError: If one is.
    """
    for path in paths:
        if open_dataset(path).config.stream != "train":
            raise DatasetError(
                f"{path} is of the stream `test`, which suites score on; render training data "
                "with --stream train"
            )


class HeldOutCheck:
    """Pairs of a held-out dataset, on which the errors of flows are measured."""

    def __init__(self, folder: Path, most: int) -> None:
        """Choose at most `most` forward pairs, evenly over the dataset."""
        self.folder = folder
        pairs = Pairs([folder], TrainConfig())
        count = min(most, len(pairs) // 2)
        chosen = np.linspace(0, len(pairs) // 2 - 1, count).astype(int)
        self.pairs = [pairs.pair(2 * int(i)) for i in chosen]

    @cached_property
    def classical(self) -> dict[str, FlowErrors]:
        """The errors of the flows that do not learn."""
        return flow_errors({"dis": dis_flow, "dis-fine": fine_dis_flow}, self.pairs)

    def errors(self, network: Raft) -> dict[str, FlowErrors]:
        """Return the errors of all flows on the same pairs."""
        return {**self.classical, **flow_errors({"raft": RaftFlow(network)}, self.pairs)}


def _check(run: _Run, at: Checkpoint) -> dict[str, dict[str, FlowErrors]]:
    out: dict[str, dict[str, FlowErrors]] = {}
    for check in run.checks:
        out[str(check.folder)] = errors = check.errors(run.network)
        _write(run.log, {
            "step": at.step, "seconds": round(at.seconds, 1), "held_out": str(check.folder),
            **{name: asdict(e) for name, e in errors.items()},
        })
    return out


def _write(log: TextIO, record: dict[str, Any]) -> None:
    log.write(json.dumps(record) + "\n")
    log.flush()
