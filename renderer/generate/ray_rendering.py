"""Sequences rendered by Ray actors, which write them into the dataset themselves."""

from __future__ import annotations

import os
import time
from collections.abc import Generator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from ...errors import RenderError
from ...robots.files import cache_folder, scratch_folder
from ..cluster import ActorWork, RayWorkers, connect_to_ray, run_on_ray
from ..dataset import DATASET_FILE, environment, sequence_name, sequence_paths
from ..runtime import address, exists
from .dataset_folder import compare_dataset
from .worker_pool import LIFETIME
from .worker_process import (
    FrameDone,
    Message,
    ModelLoaded,
    RenderTask,
    SequenceDone,
    open_renderer,
    write_sequence,
)

_LATE = 30.0
"""s after which other machines see a file that one has written to their shared folder."""


def render_on_ray(
    task: RenderTask, indices: list[int], workers: RayWorkers
) -> Generator[Message]:
    """Render sequences with the actors of a Ray cluster, and yield what happens.

    Close the iterator to stop at once. Raises RenderError for sequences whose actors died again and
    again, or that this machine does not see.
    """
    with connect_to_ray(workers) as cluster:
        work = ActorWork[int](
            "gcbench.renderer.generate.ray_rendering:RayRenderer",
            (task, workers.gpus > 0),
            lambda index: f"sequence {index:06d}", RenderError, LIFETIME)
        for index, answer in run_on_ray(work, indices, cluster):
            if index is None:
                yield answer
            else:
                yield from (FrameDone() for _ in range(answer.frames))
                yield SequenceDone()
    out = task.target or task.dataset
    if missing := _wait_for(out, {sequence_name(index) for index in indices}):
        raise RenderError(f"{len(missing)} sequences that workers have written are not in "
                          f"{address(out)}, such as {min(missing)}; give --out a folder that all "
                          "nodes share, or an address in object storage")


def _wait_for(out: Path, names: set[str]) -> set[str]:
    """Return the sequences that do not appear in time."""
    end = time.monotonic() + _LATE
    while (missing := names - sequence_paths(out).keys()) and time.monotonic() < end:
        time.sleep(1.0)
    return missing


# -- in the actor -----------------------------------------------------------------------------


@dataclass(frozen=True)
class RenderedFile:
    """What an actor tells of a sequence that it has written."""

    index: int
    frames: int
    bytes: int


class RayRenderer:
    """A renderer in an actor."""

    def __init__(self, task: RenderTask, on_gpu: bool, threads: int) -> None:
        if on_gpu:
            _choose_gpu()
        self._out = task.target or task.dataset
        self._folders = ExitStack()
        if task.target:  # the driver's scratch folder is on another machine
            work = self._folders.enter_context(scratch_folder(cache_folder() / "scratch"))
            task = replace(task, dataset=work)
        self._task = replace(task, threads=threads)
        self._renderer = open_renderer(self._task)
        self._is_compared = False

    @property
    def hello(self) -> ModelLoaded:
        """The model, as this node has it."""
        return ModelLoaded(self._renderer.asset, environment())

    def run(self, index: int) -> RenderedFile:
        """Render a sequence and write it."""
        if not self._is_compared:
            self._compare()
        frames: list[None] = []
        size = write_sequence(self._renderer, index, self._task, lambda: frames.append(None))
        return RenderedFile(index, len(frames), size)

    def _compare(self) -> None:
        """Raise an error if this node does not see the dataset that the driver has created."""
        end = time.monotonic() + _LATE
        while not exists(self._out / DATASET_FILE):  # the driver has written it
            if time.monotonic() > end:
                raise RenderError(f"does not see {address(self._out)}; give --out a folder that "
                                  "all nodes share, or an address in object storage")
            time.sleep(0.5)
        compare_dataset(self._out, self._task.config, self._renderer.asset)
        self._is_compared = True


def _choose_gpu() -> None:
    """Draw on the GPU that Ray has assigned: EGL takes the first one, whatever CUDA sees."""
    import ray

    from ..gl import DEVICE_VARIABLE

    os.environ.setdefault(DEVICE_VARIABLE, f"cuda:{ray.get_gpu_ids()[0]}")
