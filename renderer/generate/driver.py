"""A dataset from a config: every sequence that is not there yet, by several processes.

A sequence depends on the config and its index alone, is written whole or not at all, and is never
touched again. So a run may end at any moment and in any way, and the same command continues it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Collection, Generator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...errors import ConfigError, RenderError
from ...robots.files import LOCK, lock_folder, remove_leftovers
from ..dataset import (
    DATASET_FILE,
    SEQUENCES_FOLDER,
    Provenance,
    new_provenance,
    read_meta,
    read_provenance,
    sequence_counts,
    sequence_name,
    sequence_paths,
    write_provenance,
)
from ..runtime import Bar, cpu_count, dump_json, frame_bar, say
from ..scene import RenderConfig, config_tree, differences, draws_of, parse_config, resolve
from ..types import Sequence
from .worker_pool import WorkerDied, render_in_workers
from .worker_process import FrameDone, ModelLoaded, RenderTask

_SOURCE = "gcbench.renderer.generate.sequence_renderer:SequenceRenderer"


@dataclass(frozen=True)
class Summary:
    """What a run did, and what is there now."""

    dataset: Path
    rendered: int
    """Sequences of this run."""
    sequences: int
    """In the dataset."""
    frames: int
    """In the dataset."""
    unobservable: int
    """Sequences whose motion cannot be seen."""
    refused: Mapping[str, int]
    """Draws that were refused for the dataset, by reason."""
    seconds: float
    """Of this run."""

    def describe(self) -> str:
        """What a user wants to know after a run, in a few lines."""
        lines = [
            f"{self.dataset}: {self.sequences} sequences, {self.frames} frames "
            f"({self.rendered} sequences rendered in {self.seconds:.1f} s)"
        ]
        if self.refused:
            reasons = ", ".join(f"{k} {v}" for k, v in self.refused.items())
            lines.append(f"draws refused because the motion could not be seen: {reasons}")
        if self.unobservable:
            lines.append(
                f"{self.unobservable} sequences are not observable (kept, and marked in "
                "their meta.json)"
            )
        return "\n".join(lines)


def plan_workers(cores: int, requested: int | None) -> tuple[int, int]:
    """(processes, threads of the software rasterizer in each); at least one process."""
    workers = cores if requested is None else requested
    if workers < 1:
        raise ConfigError(f"{workers} workers cannot render; ask for 1 or more")
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
        ConfigError: if a value of the config is invalid.
        ModelError: if the robot cannot be loaded.
        RenderError: if this machine cannot render.

    Example:
        >>> config = gb.RenderConfig("owi535", frames=2, width=64, height=48)
        >>> sequence = gb.render_sequence(config, 7)
        >>> sequence.depth.shape
        (2, 48, 64)
    """
    from .sequence_renderer import SequenceRenderer

    renderer = SequenceRenderer(config)
    try:
        return renderer.render(index).in_memory()
    finally:
        renderer.close()


def render_dataset(
    config: RenderConfig,
    n: int | Collection[int],
    out: str | Path,
    workers: int | None = None,
    progress: bool = True,
    source: str = _SOURCE,
) -> Summary:
    """Render sequences of a config into a dataset, those that it lacks.

    What is done stays when the function raises, also for Ctrl-C (KeyboardInterrupt); the same call
    continues.

    Args:
        config: What to render.
        n: Number of sequences in the dataset (0 to n-1), or the numbers of those to render.
        out: Folder of the dataset.
        workers: Processes that render; default: one for each core.
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
    if source == _SOURCE:  # another source has robots of its own
        config = resolve(config)
    cores = cpu_count()
    plan_workers(cores, workers)  # refuses before anything is written
    wanted = range(n) if isinstance(n, int) else sorted({*n})
    if not wanted or wanted[0] < 0:
        raise ConfigError("no sequences to render; give a number of 1 or more, or indices from 0")
    try:
        with _open_folder(out):
            config = _with_old_draws(out, config)
            provenance = _open(out, config)
            there = sequence_paths(out)
            todo = [i for i in wanted if sequence_name(i) not in there]
            if todo:
                count, threads = plan_workers(cores, min(workers or cores, len(todo)))
                task = RenderTask(source, config, out.absolute(), threads)
                total = len(wanted) * config.frames
                done = total - len(todo) * config.frames
                try:
                    with frame_bar(total, done, progress) as bar:
                        provenance = _render(task, todo, count, provenance, bar)
                finally:
                    _tidy(out)
            return _finish(out, provenance, len(todo), started)
    except OSError as error:
        raise RenderError(f"{error.filename or out}: {error.strerror or error}") from error


def _render(
    task: RenderTask, todo: list[int], workers: int, provenance: Provenance, bar: Bar
) -> Provenance:
    """Render `todo`; the provenance that is returned, and on disk, names the model."""
    with closing(render_in_workers(task, todo, workers)) as events:
        for event in events:
            if isinstance(event, ModelLoaded):
                provenance = _with_asset(task.dataset, provenance, event.asset)
            elif isinstance(event, FrameDone):
                bar.update()
            elif isinstance(event, WorkerDied):
                bar.update(-event.frames)
                say(event.notice)
    return provenance


def _with_old_draws(out: Path, config: RenderConfig) -> RenderConfig:
    """The config; for a dataset in `out` that is older than `twin_of`, with its draws."""
    if (sequence_paths(out) and (out / DATASET_FILE).exists()
            and "twin_of" not in read_provenance(out).config
            and config.twin_of == draws_of(config.robot)):
        say(f"{out} continues with the draws of the version that began it")
        return replace(config, twin_of="")
    return config


def _open(out: Path, config: RenderConfig) -> Provenance:
    """What the dataset in `out` is, or will be. Raises ConfigError if it is another one."""
    here = new_provenance(config)
    if not sequence_paths(out):  # what failed before its first sequence binds nobody
        return here
    if not (out / DATASET_FILE).exists():
        raise ConfigError(
            f"{out} holds sequences but no {DATASET_FILE}; choose another --out folder")
    there = read_provenance(out)
    # A field that is newer than the dataset has its default there.
    old = parse_config(there.config, str(out / DATASET_FILE))
    # The folder that meshes are read from does not count: an old dataset has none.
    changed = differences({**config_tree(old), "root": here.config["root"]}, here.config)
    changed += differences({"generator": there.generator}, {"generator": here.generator})
    if changed:
        raise ConfigError(
            f"{out} holds a dataset of another configuration ({'; '.join(changed)}); "
            "choose another --out folder, or delete this one"
        )
    if here.environments[0] not in there.environments:
        return replace(there, environments=(*there.environments, *here.environments))
    return there


def _with_asset(out: Path, provenance: Provenance, asset: Mapping[str, Any]) -> Provenance:
    """The provenance with the model's, on disk before the first sequence is."""
    now = json.loads(dump_json(asset))
    there = provenance.assets[0] if provenance.assets else now
    # datasets of the first edition have no hashes of meshes and textures
    changed = differences(there, {k: v for k, v in now.items() if k != "files" or k in there})
    if changed:
        raise ConfigError(f"{out} was rendered with other model files ({'; '.join(changed)}); "
                          "choose another --out folder")
    growing = replace(provenance, assets=provenance.assets or (now,), counts=None)
    if growing != provenance:
        write_provenance(out, growing)
    return growing


def _finish(out: Path, provenance: Provenance, rendered: int, started: float) -> Summary:
    """Sum up what is on disk; `dataset.json` says so from now on."""
    counts = sequence_counts(read_meta(path) for path in sequence_paths(out).values())
    finished = replace(provenance, counts=counts)
    if not (out / DATASET_FILE).exists() or read_provenance(out) != finished:
        write_provenance(out, finished)
    seconds = time.monotonic() - started
    return Summary(dataset=out, rendered=rendered, seconds=seconds, **counts)


@contextmanager
def _open_folder(out: Path) -> Generator[None]:
    """Create and lock the folder of a dataset; leave none behind if it gets no sequence."""
    created = [folder for folder in (out, *out.parents) if not folder.exists()]
    out.mkdir(parents=True, exist_ok=True)
    try:
        with lock_folder(out):
            _tidy(out)
            try:
                yield
            finally:
                _remove_without_sequences(out, created)
    except OSError:  # also when the lock cannot be written
        _remove_without_sequences(out, created)
        raise


def _remove_without_sequences(out: Path, created: list[Path]) -> None:
    """Remove a dataset's folder, and its parents, that were created and have no sequence."""
    if created and not sequence_paths(out):
        for file in (out / DATASET_FILE, out / LOCK):
            file.unlink(missing_ok=True)
        for folder in (out / SEQUENCES_FOLDER, *created):
            with suppress(OSError):  # something else is in it
                folder.rmdir()


def _tidy(out: Path) -> None:
    """Remove what killed processes have left."""
    remove_leftovers(out)
    remove_leftovers(out / SEQUENCES_FOLDER)
