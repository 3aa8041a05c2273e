"""What runs in a rendering process: it receives indices, renders and writes, and reports."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ..runtime import Problem, receive_tasks, upload_file
from ..scene import RenderConfig
from .rendered_sequence import Renderer


@dataclass(frozen=True)
class RenderTask:
    """What a process renders."""

    source: str
    """"module:attribute" of a callable RenderConfig -> Renderer"""
    config: RenderConfig
    dataset: Path
    """Folder to write to."""
    threads: int
    """Of the software rasterizer."""
    target: Path | None = None
    """Address in object storage; a sequence is moved there when it is whole."""


@dataclass(frozen=True)
class ModelLoaded:
    """The process waits for its first index."""

    asset: Mapping[str, Any]
    environment: Mapping[str, Any] | None = None
    """Software of its machine, if that is another one."""


@dataclass(frozen=True)
class FrameDone:
    """One more frame is rendered."""


@dataclass(frozen=True)
class SequenceDone:
    """The sequence is in the dataset; the process waits for the next index."""


Message = ModelLoaded | FrameDone | SequenceDone


def render_tasks(connection: Connection, task: RenderTask) -> None:
    """Receive indices, render them and report, until the connection ends."""
    where = ""
    try:
        renderer = open_renderer(task)
        connection.send(ModelLoaded(renderer.asset))
        for index in receive_tasks(connection, Connection.recv):
            where = f"sequence {index:06d}: "
            write_sequence(renderer, index, task, lambda: connection.send(FrameDone()))
            connection.send(SequenceDone())
        renderer.close()
    except Exception as error:
        connection.send(Problem.describe(error, where, task.dataset))


def open_renderer(task: RenderTask) -> Renderer:
    """Load the model of a task, in a process that has drawn nothing."""
    os.environ["LP_NUM_THREADS"] = str(task.threads)  # Mesa reads it when it loads
    keep_freed_memory()
    import cv2

    cv2.setNumThreads(1)
    module, _, attribute = task.source.partition(":")
    return getattr(import_module(module), attribute)(task.config)


def write_sequence(
    renderer: Renderer, index: int, task: RenderTask, report: Callable[[], None]
) -> int:
    """Render a sequence into the dataset, and return the bytes of its file.

    `report` is called after each frame.
    """
    from ..dataset import SEQUENCES_FOLDER, SequenceWriter

    rendered = renderer.render(index)
    with SequenceWriter(
        task.dataset, index, rendered.depth_unit, rendered.coordinate_box
    ) as writer:
        for frame in rendered.frames:
            writer.add(frame)
            report()
        path = writer.finish(*rendered.finish())
    size = path.stat().st_size
    if task.target:
        upload_file(path, task.target / SEQUENCES_FOLDER / path.name)
        path.unlink()
    return size


def keep_freed_memory() -> None:
    """Let glibc keep what a frame frees for the next one.

    By default it returns arrays of an image's size to the system, and the page faults of new ones
    take a tenth of the time of a frame.
    """
    if set_option := getattr(ctypes.CDLL(None), "mallopt", None):  # other C libraries have none
        trim_threshold, mmap_threshold = -1, -3
        set_option(mmap_threshold, 2**25)  # the largest that glibc takes
        set_option(trim_threshold, 2**28)
