"""What runs in a rendering process: it receives indices, renders and writes, and reports."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ...errors import GcbenchError, RenderError
from ..runtime import receive_tasks, upload_file
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


@dataclass(frozen=True)
class FrameDone:
    """One more frame is rendered."""


@dataclass(frozen=True)
class SequenceDone:
    """The sequence is in the dataset; the process waits for the next index."""


@dataclass(frozen=True)
class Problem:
    """The process gives up."""

    text: str
    """One line for the user, or the traceback of a bug."""
    error: type[GcbenchError] | None
    """Kind of the error; None for a bug."""


Message = ModelLoaded | FrameDone | SequenceDone


def render_tasks(connection: Connection, task: RenderTask) -> None:
    """Receive indices, render them and report, until the connection ends."""
    os.environ["LP_NUM_THREADS"] = str(task.threads)  # Mesa reads it when it loads
    where = ""
    try:
        import cv2

        cv2.setNumThreads(1)
        module, _, attribute = task.source.partition(":")
        renderer: Renderer = getattr(import_module(module), attribute)(task.config)
        connection.send(ModelLoaded(renderer.asset))
        for index in receive_tasks(connection, Connection.recv):
            where = f"sequence {index:06d}: "
            _render(renderer, index, task, connection)
            connection.send(SequenceDone())
        renderer.close()
    except GcbenchError as error:
        connection.send(Problem(f"{where}{error}", type(error)))
    except OSError as error:  # a full disk, no permission
        file = error.filename or task.dataset
        connection.send(Problem(f"{where}{file}: {error.strerror or error}", RenderError))
    except Exception:
        import traceback

        connection.send(Problem(where + traceback.format_exc(), None))


def _render(renderer: Renderer, index: int, task: RenderTask, connection: Connection) -> None:
    from ..dataset import SEQUENCES_FOLDER, SequenceWriter

    rendered = renderer.render(index)
    with SequenceWriter(
        task.dataset, index, rendered.depth_unit, rendered.coordinate_box
    ) as writer:
        for frame in rendered.frames:
            writer.add(frame)
            connection.send(FrameDone())
        path = writer.finish(*rendered.finish())
    if task.target:
        upload_file(path, task.target / SEQUENCES_FOLDER / path.name)
        path.unlink()
