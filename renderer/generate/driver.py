"""A dataset from a config: every sequence that is not there yet, by several processes.

A sequence depends on the config and its index alone, is written whole or not at all, and is never
touched again. So a run may end at any moment and in any way, and the same command continues it.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from ...errors import ConfigError, RenderError
from ..cluster import RayWorkers
from ..dataset import sequence_name, sequence_paths
from ..runtime import (
    Bar,
    Shard,
    address,
    convert_fields,
    count_workers,
    cpu_count,
    frame_bar,
    plural,
    say,
)
from ..scene import RenderConfig, resolve
from ..types import Sequence
from .dataset_folder import DatasetFolder, open_folder
from .ray_rendering import render_on_ray
from .worker_pool import WorkerDied, render_in_workers
from .worker_process import FrameDone, ModelLoaded, RenderTask

_MAX_SEQUENCES = 10**7
_SOURCE = "gcbench.renderer.generate.sequence_renderer:SequenceRenderer"


@dataclass(frozen=True)
class Summary:
    """What a run did, and what is there now: in the dataset, or of the run's shard."""

    dataset: Path
    rendered: int
    """Sequences of this run."""
    sequences: int
    frames: int
    unobservable: int
    """Sequences whose motion cannot be seen."""
    refused: Mapping[str, int]
    """Draws that were refused, by reason."""
    seconds: float
    """Of this run."""
    notes: tuple[str, ...] = ()
    """What the reader decided about the model, such as frozen joints and missing meshes."""

    def describe(self) -> str:
        """What a user wants to know after a run, in a few lines."""
        lines = [
            f"{address(self.dataset)}: {plural(self.sequences, 'sequence')}, "
            f"{plural(self.frames, 'frame')} ({self.rendered} rendered in {self.seconds:.1f} s)"
        ]
        if self.refused:
            reasons = ", ".join(f"{k} {v}" for k, v in self.refused.items())
            lines.append(f"draws that were replaced by others, by reason: {reasons}")
        if self.unobservable:
            lines.append(f"not observable: {plural(self.unobservable, 'sequence')} (kept, and "
                         "marked in meta.json)")
        lines += [f"note: {note}" for note in self.notes]
        return "\n".join(lines)


def plan_workers(cores: int, requested: int | None) -> tuple[int, int]:
    """(processes, threads of the software rasterizer in each); 0 and None are one a core."""
    workers = requested or cores
    return workers, max(1, cores // workers)


def render_sequence(config: RenderConfig, index: int = 0) -> Sequence:
    """Render one sequence in memory.

    It equals the stored one, except that files round depth, flow and the other images.

    Args:
        config: What to render.
        index: Number of the sequence. A sequence depends on the config and its number only.

    Returns:
        The sequence, its images as arrays.

    Raises:
        ConfigError: if a value of the config is invalid, or the index is negative.
        ModelError: if the robot cannot be loaded.
        RenderError: if this machine cannot render.

    Example:
        >>> config = gb.RenderConfig("owi535", frames=2, width=64, height=48)
        >>> sequence = gb.render_sequence(config, 7)
        >>> sequence.depth.shape
        (2, 48, 64)
    """
    from .sequence_renderer import SequenceRenderer

    if index < 0:
        raise ConfigError(f"there is no sequence {index}; the first is 0")
    renderer = SequenceRenderer(config)
    try:
        return renderer.render(index).in_memory()
    finally:
        renderer.close()


def render_dataset(
    config: RenderConfig,
    n: int | Collection[int],
    out: str | Path,
    workers: int | RayWorkers | None = None,
    progress: bool = True,
    source: str = _SOURCE,
) -> Summary:
    """Render sequences of a config into a dataset, those that it lacks.

    What is done stays when the function raises, also for Ctrl-C (KeyboardInterrupt); the same call
    continues.

    Args:
        config: What to render.
        n: Number of sequences in the dataset (0 to n-1), or the numbers of those to render. With a
            `Shard`, several calls may write to one folder at the same time.
        out: Folder of the dataset, or its address in object storage, such as "s3://bucket/data".
        workers: Processes that render; 0 and None: one for each core. `RayWorkers` renders on a
            Ray cluster.
        progress: Whether to show a bar on stderr.
        source: "module:attribute" of what renders (`Renderer`).

    Returns:
        What the run did, and what the dataset holds now.

    Raises:
        ConfigError: if the folder holds another dataset, or a value is invalid.
        RenderError: if the model or a sequence cannot be rendered.

    Example:
        >>> config = gb.RenderConfig("owi535", frames=2, width=64, height=48)
        >>> summary = gb.render_dataset(config, 1, "data/owi535", progress=False)
        >>> summary.sequences, summary.frames
        (1, 2)
    """
    out = Path(out)
    started = time.monotonic()
    config = convert_fields(config, RenderConfig)
    if source == _SOURCE:  # another source has robots of its own
        config = resolve(config)
    if not isinstance(workers, RayWorkers):
        workers = count_workers(workers)  # refuses before anything is written
    wanted = range(n) if isinstance(n, int) else sorted({*n})
    if not wanted and not isinstance(n, Shard):
        raise ConfigError("no sequences to render; give --n 1 or more")
    if wanted and wanted[0] < 0:
        raise ConfigError(f"there is no sequence {wanted[0]}; the first is 0")
    if wanted and wanted[-1] >= _MAX_SEQUENCES:
        raise ConfigError(f"a dataset has at most {_MAX_SEQUENCES} sequences; make several")
    try:
        with open_folder(out, config, n if isinstance(n, Shard) else None) as folder:
            there = sequence_paths(out)
            todo = [i for i in wanted if sequence_name(i) not in there]
            if todo:
                task = RenderTask(source, folder.config, folder.work, 1, folder.target)
                total = len(wanted) * config.frames
                done = total - len(todo) * config.frames
                try:
                    with frame_bar(total, done, progress) as bar:
                        _render(task, todo, workers, folder, bar)
                finally:
                    folder.remove_leftovers()
            counts = folder.finish()
            seconds = time.monotonic() - started
            return Summary(dataset=out, rendered=len(todo), seconds=seconds, notes=folder.notes,
                           **counts)
    except OSError as error:
        raise RenderError(f"{error.filename or out}: {error.strerror or error}") from error


def _render(
    task: RenderTask, todo: list[int], workers: int | RayWorkers, folder: DatasetFolder, bar: Bar,
) -> None:
    """Render `todo`; the provenance on disk names the model."""
    if isinstance(workers, RayWorkers):
        messages = render_on_ray(task, todo, workers)
    else:
        count, threads = plan_workers(cpu_count(), min(workers, len(todo)))
        messages = render_in_workers(replace(task, threads=threads), todo, count)
    with closing(messages):
        for message in messages:
            if isinstance(message, ModelLoaded):
                folder.add_model(message.asset, message.environment)
            elif isinstance(message, FrameDone):
                bar.update()
            elif isinstance(message, WorkerDied):
                bar.update(-message.frames)
                say(message.notice)
