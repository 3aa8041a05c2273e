"""`gcbench train`: from renders to weights, for every network.

A run is determined by its options. Killed at any moment, it continues from its last checkpoint as
if nothing had happened: sample i is always the same, and step k takes `batch` samples from
k * batch on.
"""

# pyright: basic
from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...errors import ConfigError, DatasetError, GcbenchError, MethodError
from ...renderer.runtime import count_workers, defer_interrupts, require_local, say
from ...robots.files import lock_folder, remove_leftovers, write_atomically
from ..networks.torch_runtime import find_device, nn, torch
from ..networks.weights import (
    Checkpoint,
    has_checkpoint,
    read_checkpoint,
    write_checkpoint,
    write_weights,
)
from .config import TrainConfig
from .curves import write_curves
from .data import (
    check_sequences,
    find_datasets,
    refuse_test_streams,
    render_datasets,
    warn_of_leaks,
)
from .run_options import keep_options, refuse_other_network
from .task import Samples, Scores, TrainingTask

_LOGGED = 20  # steps from one line of the log to the next


@dataclass(frozen=True)
class _Run:
    """What a run needs in each step."""

    task: TrainingTask
    network: nn.Module
    optimizer: torch.optim.Optimizer
    held_out: list[Path]

    @property
    def log(self) -> Path:
        return self.task.config.out / "log.jsonl"

    def save(self, at: Checkpoint) -> None:
        """Write weights and checkpoint; a run that is killed between them repeats some steps."""
        config, name = self.task.config, self.task.name
        write_weights(config.out / f"{name}.safetensors", self.network, self.task.notes(),
                      config.half)
        write_checkpoint(config.out, self.network, self.optimizer, at)

    def write(self, at: Checkpoint, **record: Any) -> None:
        """Append a line to the log."""
        with self.log.open("a") as file:
            file.write(_log_line(at, record))

    def measure(self, at: Checkpoint) -> dict[str, Scores]:
        """Return the errors on the held-out data, by dataset; log those that are new (a run that is
        done may be called again), and draw the curves."""
        out: dict[str, Scores] = {}
        there = set(self.log.read_text().splitlines(keepends=True)) if self.log.exists() else ()
        for folder in self.held_out:
            out[str(folder)] = scores = self.task.measure(self.network.eval(), folder)
            record = {"held_out": str(folder), **scores}
            if _log_line(at, record) not in there:
                self.write(at, **record)
        write_curves(self.log, self.task.config.out / "curves.html", self.task.name,
                     self.task.units)
        return out


def train(task: TrainingTask) -> dict[str, Scores]:
    """Train until the last step; return the errors on the held-out datasets.

    Raises:
        ConfigError: If an option is out of range, or a file of weights does not fit.
        DatasetError: If a dataset is missing, has no samples, or is of the stream "test".
        MethodError: If the loss diverges.
        RenderError: If this machine cannot render.
    """
    config = task.config
    require_local(config.out, "--out")
    task.check_options()
    if not config.steps:
        _check_measuring(config)
    device = find_device(config.device)
    if config.threads:
        torch.set_num_threads(config.threads)
        cv2.setNumThreads(config.threads)
    torch.manual_seed(config.seed)
    network = task.make_network()
    if config.start_from is not None:
        task.load_start(network, config.start_from)
    run = _Run(task, network.to(device), task.make_optimizer(network),
               find_datasets(config.held_out))
    given = find_datasets(config.data)
    refuse_test_streams(given)
    check_sequences([*given, *run.held_out], task.describe_misfit)
    warn_of_leaks(run.held_out, given)
    config.out.mkdir(parents=True, exist_ok=True)
    with lock_folder(config.out):
        remove_leftovers(config.out)
        if has_checkpoint(config.out):
            refuse_other_network(config.out, task.name)
        if config.steps:
            keep_options(config, given, has_checkpoint(config.out))
        at = read_checkpoint(config.out, network, run.optimizer)
        _cut_log(run.log, at.step)
        if config.steps:
            data = given
            if not data:
                planned = [p for p in task.plan_data() if not (p.held_out and run.held_out)]
                data, further = render_datasets(config.out / "data", planned, config)
                warn_of_leaks(run.held_out, data)
                run.held_out.extend(further)
            if not run.held_out:
                say("no errors will be measured: there is no --held-out dataset")
            samples = task.open_samples(data, network)
            if not at.step:
                task.take_ranges(network, samples)
                run.measure(at)  # what does not fit is told now, not after the first steps
            at = _train_steps(run, samples, at)
        return run.measure(at)


def _check_measuring(config: TrainConfig) -> None:
    """Raise ConfigError unless it is clear which weights are measured on which data."""
    if not config.held_out:
        raise ConfigError("--steps 0 measures errors on held-out data; name it with --held-out")
    if has_checkpoint(config.out) and config.start_from is not None:
        raise ConfigError(f"{config.out} has a run; leave out --start-from to measure it, or name "
                          "another --out")
    if not has_checkpoint(config.out) and config.start_from is None:
        raise ConfigError(f"{config.out} has no run to measure; name its folder with --out, or "
                          "weights with --start-from")


def _train_steps(run: _Run, samples: Samples, at: Checkpoint) -> Checkpoint:
    """Train from a checkpoint until the last step; return the checkpoint there."""
    from tqdm import tqdm

    task, config, network = run.task, run.task.config, run.network
    if not len(samples):
        raise DatasetError("there is nothing to learn from in the datasets")
    steps, whole, mean = task.count_steps(samples), True, float("nan")
    started, saved = time.monotonic() - at.seconds, time.monotonic()
    device = next(network.parameters()).device
    bar = tqdm(total=steps, initial=at.step, unit="step", dynamic_ncols=True)
    try:
        for batch in _batches(samples, config, range(at.step, steps), device):
            whole = False  # a step that fails leaves a state that no run would have
            with defer_interrupts():
                loss = _train_step(run, batch, at.step, steps)
                at, whole = Checkpoint(at.step + 1, time.monotonic() - started), True
            mean = loss if np.isnan(mean) else 0.98 * mean + 0.02 * loss
            bar.update()
            if at.step % _LOGGED == 0 or at.step == steps:
                bar.set_postfix_str(f"loss {mean:.3f}")
                run.write(at, loss=loss)
            if time.monotonic() - saved > 60 * config.minutes:
                run.save(at)
                saved = time.monotonic()
            if at.step % config.every == 0 and at.step < steps:
                run.measure(at)
    finally:
        bar.close()
        if whole and at.step > 0:
            run.save(at)
    return at


def _train_step(run: _Run, batch: list[torch.Tensor], step: int, steps: int) -> float:
    """Make a step of the optimizer; return the loss."""
    task, network, progress = run.task, run.network, step / steps
    for group in run.optimizer.param_groups:
        group["lr"] = task.rate(progress)
    torch.manual_seed(1_000_003 * task.config.seed + step)  # of dropout: a later run repeats it
    loss = task.loss(network.train(), batch, progress)
    run.optimizer.zero_grad(set_to_none=True)
    loss.backward()
    norm = torch.nn.utils.clip_grad_norm_(network.parameters(), task.config.max_gradient)
    if not torch.isfinite(norm):
        raise MethodError(f"training diverged at step {step}; lower --rate")
    run.optimizer.step()
    return loss.item()


class _NumberedSamples(torch.utils.data.Dataset[tuple[torch.Tensor, ...]]):
    """Samples by number, as tensors."""

    def __init__(self, samples: Samples) -> None:
        self.samples = samples

    def __getitem__(self, number: int) -> tuple[torch.Tensor, ...]:
        cv2.setNumThreads(1)
        return tuple(map(torch.from_numpy, vars(self.samples.sample(number)).values()))


def _leave_signals_to_the_parent(_: int) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a scheduler sends it to all processes


def _batches(
    samples: Samples, config: TrainConfig, steps: range, device: torch.device
) -> Iterator[list[torch.Tensor]]:
    """The batches of steps."""
    workers = 0 if config.workers is None else count_workers(config.workers)
    loader = torch.utils.data.DataLoader(
        _NumberedSamples(samples),
        batch_size=config.batch,
        sampler=range(steps.start * config.batch, steps.stop * config.batch),
        num_workers=workers,
        multiprocessing_context="spawn" if workers else None,
        prefetch_factor=4 if workers else None,
        worker_init_fn=_leave_signals_to_the_parent,
    )
    try:
        for batch in loader:
            yield [tensor.to(device, non_blocking=True) for tensor in batch]
    except GcbenchError as error:  # of a worker: PyTorch adds its traceback
        said = str(error).strip().splitlines()
        if len(said) == 1:
            raise
        raise type(error)(said[-1].partition(": ")[2]) from None


def _log_line(at: Checkpoint, record: dict[str, Any]) -> str:
    return json.dumps(_finite({"step": at.step, "seconds": round(at.seconds, 1), **record})) + "\n"


def _finite(value: Any) -> Any:
    """Return a value of JSON with null in place of numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _cut_log(path: Path, step: int) -> None:
    """Remove the lines of steps that are repeated, and what a kill has left of a line."""
    kept: list[str] = []
    text = path.read_bytes().decode(errors="replace") if path.exists() else ""
    for line in text.splitlines():
        try:
            if step and json.loads(line)["step"] <= step:
                kept.append(line + "\n")
        except (ValueError, KeyError, TypeError):
            continue
    write_atomically(path, "".join(kept).encode())
