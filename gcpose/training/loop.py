"""`gcbench train flow`: the network of `raft.py`, from renders to weights."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false, reportUntypedBaseClass=false

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np

from ...errors import GcbenchError
from ...renderer.dataset import open_dataset
from ...robots.files import lock_folder
from ..images import dis_flow, fine_dis_flow
from ..images.network_flow import RaftFlow
from ..networks.raft import Raft
from ..networks.torch_runtime import device_named, torch
from ..networks.weights import read_weights
from .checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from .config import TrainConfig
from .data import rendered
from .errors import FlowErrors, flow_errors
from .loss import flow_loss
from .pairs import Pairs

_WARM_UP = 0.05  # share of the steps in which the rate rises
_MOST_GRADIENT = 1.0
_MOST_CHECKED = 40
"""Pairs of each held-out dataset that a check looks at."""


def train(config: TrainConfig) -> dict[str, dict[str, FlowErrors]]:
    """Train until step `steps`; the errors on each held-out dataset, by dataset and flow.

    Raises GcbenchError for options or data that do not work, or a folder of another run.
    """
    if config.crop[0] % 16 or config.crop[1] % 16 or min(config.crop) < 48:
        words = " ".join(map(str, config.crop))
        raise GcbenchError(f"--crop {words}: give multiples of 16 from 48")
    if config.steps < 0 or config.batch < 1 or config.every < 1:
        raise GcbenchError("--steps must be 0 or more, --batch and --every 1 or more")
    device = device_named(config.device)
    if config.threads:
        torch.set_num_threads(config.threads)
        cv2.setNumThreads(config.threads)
    torch.manual_seed(config.seed)
    network = Raft()
    if config.start_from is not None:
        network.load_state_dict(read_weights(config.start_from, network.state_dict(), "raft"))
    network.to(device)
    optimizer = torch.optim.AdamW(network.parameters(), config.rate, (0.9, 0.99), weight_decay=1e-4)
    checks = [Check(path) for path in folders(config.held_out)]
    given = folders(config.data)
    refuse_test_streams(given)
    config.out.mkdir(parents=True, exist_ok=True)
    with lock_folder(config.out), (config.out / "log.jsonl").open("a") as log:
        at = read_checkpoint(config.out, network, optimizer)
        if at.step < config.steps:
            own = config.out / "data"
            data = given or rendered(
                own, config.models, config.seed, config.workers or None, config.robots)
            pairs = Pairs(data, config.seed, config.crop)
            at = _loop(config, network, optimizer, at, pairs, checks, log)
        return _check(network, checks, at, log)


def _loop(
    config: TrainConfig, network: Raft, optimizer: torch.optim.Optimizer, at: Checkpoint,
    pairs: Pairs, checks: list[Check], log: TextIO,
) -> Checkpoint:
    from tqdm import tqdm

    device = next(network.parameters()).device
    kind = torch.bfloat16 if config.precision == "bfloat16" else torch.float32
    started, saved = time.monotonic() - at.seconds, time.monotonic()
    step, mean = at.step, float("nan")
    bar = tqdm(total=config.steps, initial=step, unit="step", dynamic_ncols=True)
    try:
        for a, b, flow, part, weight in _batches(pairs, config, step, device):
            for group in optimizer.param_groups:
                group["lr"] = config.rate * one_cycle(step / config.steps)
            with torch.autocast(device.type, kind, enabled=kind != torch.float32):
                out = network.train()(a, b, config.iterations)
            loss = flow_loss(out, flow, part, weight, step / config.steps)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            norm = torch.nn.utils.clip_grad_norm_(network.parameters(), _MOST_GRADIENT)
            if not torch.isfinite(norm):
                raise GcbenchError(f"training left all bounds at step {step}; lower --rate")
            optimizer.step()
            step += 1
            mean = loss.item() if np.isnan(mean) else 0.98 * mean + 0.02 * loss.item()
            bar.update()
            at = Checkpoint(step, time.monotonic() - started)
            if step % 20 == 0:
                bar.set_postfix_str(f"loss {mean:.3f}")
                _write(log, {"step": step, "seconds": round(at.seconds, 1), "loss": round(mean, 4)})
            if time.monotonic() - saved > 60 * config.minutes:
                write_checkpoint(config.out, network, optimizer, at)
                saved = time.monotonic()
            if step % config.every == 0 and step < config.steps:
                _check(network, checks, at, log)
    finally:
        bar.close()
        if step > 0:
            write_checkpoint(config.out, network, optimizer, at)
    return at


class _Numbered(torch.utils.data.Dataset[tuple[torch.Tensor, ...]]):
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
    """Those from `step` on: the same, wherever a run was interrupted."""
    loader = torch.utils.data.DataLoader(
        _Numbered(pairs),
        batch_size=config.batch,
        sampler=range(step * config.batch, config.steps * config.batch),
        num_workers=config.workers,
        multiprocessing_context="spawn" if config.workers else None,
        prefetch_factor=4 if config.workers else None,
    )
    for batch in loader:
        yield [tensor.to(device, non_blocking=True) for tensor in batch]


def one_cycle(progress: float) -> float:
    """Learning rate as a share of the highest: up in the first 5 % of training, then down to 0."""
    if progress < _WARM_UP:
        return 0.04 + 0.96 * progress / _WARM_UP
    return max(0.0, (1.0 - progress) / (1.0 - _WARM_UP))


def folders(paths: tuple[Path, ...]) -> list[Path]:
    """Datasets among the paths and, where one is none, in it."""
    out: list[Path] = []
    for path in paths:
        found = [path] if (path / "dataset.json").exists() else sorted(
            p.parent for p in path.glob("*/dataset.json"))
        if not found:
            raise GcbenchError(f"{path}: there is no dataset; render one with `gcbench render`")
        out += found
    return out


def refuse_test_streams(paths: list[Path]) -> None:
    """Raises GcbenchError if one of the datasets is of the stream that suites hold."""
    for path in paths:
        if open_dataset(path).config.stream != "train":
            raise GcbenchError(
                f"{path} is of the stream `test`, which suites score on; render what is learned "
                "from with --stream train"
            )


class Check:
    """Pairs of a held-out dataset, and how well others do on them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        pairs = Pairs([folder], 0)
        count = min(_MOST_CHECKED, len(pairs) // 2)
        chosen = np.linspace(0, len(pairs) // 2 - 1, count).astype(int)
        self.pairs = [pairs.pair(2 * int(i)) for i in chosen]  # forward

    @cached_property
    def others(self) -> dict[str, FlowErrors]:
        """Of the flows that do not learn."""
        return flow_errors({"dis": dis_flow, "dis-fine": fine_dis_flow}, self.pairs)

    def errors(self, network: Raft) -> dict[str, FlowErrors]:
        """Of all flows on the same pairs."""
        return {**self.others, **flow_errors({"raft": RaftFlow(network)}, self.pairs)}


def _check(
    network: Raft, checks: list[Check], at: Checkpoint, log: TextIO
) -> dict[str, dict[str, FlowErrors]]:
    out: dict[str, dict[str, FlowErrors]] = {}
    for check in checks:
        out[str(check.folder)] = errors = check.errors(network)
        _write(log, {
            "step": at.step, "seconds": round(at.seconds, 1), "held_out": str(check.folder),
            **{name: asdict(e) for name, e in errors.items()},
        })  # fmt: skip
    return out


def _write(log: TextIO, record: dict[str, Any]) -> None:
    log.write(json.dumps(record) + "\n")
    log.flush()
