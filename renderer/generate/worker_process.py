"""A process that renders sequences, one after another, until it is told to stop.

Nothing heavy is imported before the environment is set: Mesa and BLAS read it when they load.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from ...errors import GcbenchError
from ..scene import RenderConfig

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..types import Frame, Meta, State


class Rendered(Protocol):
    """A sequence that renders while its frames are iterated."""

    frames: Iterator[Frame]
    depth_unit: float
    """m per unit of the depth images"""
    refused: Mapping[str, int]
    """Draws that were refused, by reason."""
    coordinate_box: NDArray[np.float64] | None
    """[P 2 3] m, if the frames have coordinates"""
    meta: Meta
    """After the last frame."""
    state: State
    """After the last frame."""


class Renderer(Protocol):
    """What `source` makes from a config: renders any sequence of it; one per process."""

    @property
    def asset(self) -> Mapping[str, Any]: ...
    def render(self, index: int, /) -> Rendered: ...
    def close(self) -> None: ...


@dataclass(frozen=True)
class Task:
    """What a worker is made for."""

    source: str
    """"module:attribute" of a callable RenderConfig -> Renderer"""
    config: RenderConfig
    dataset: Path
    threads: int
    """Of the software rasterizer."""


@dataclass(frozen=True)
class Ready:
    """The model is loaded; waits for its first index."""

    asset: Mapping[str, Any]


@dataclass(frozen=True)
class FrameDone:
    """One more frame is rendered."""


@dataclass(frozen=True)
class SequenceDone:
    """The sequence is on disk; waits for the next index."""


@dataclass(frozen=True)
class Problem:
    """The worker gives up."""

    message: str
    """One line that a user understands, or a traceback."""
    is_bug: bool


def work(connection: Connection, task: Task) -> None:
    """Receive indices, render them, report; ends at None. The main function of the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; the parent decides
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ["LP_NUM_THREADS"] = str(task.threads)
    for library in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(library, "1")  # the processes are the parallelism
    index: int | None = None
    try:
        renderer = _load(task)
        connection.send(Ready(renderer.asset))
        while (index := connection.recv()) is not None:
            _render(renderer, index, task.dataset, connection)
            connection.send(SequenceDone())
        renderer.close()
    except GcbenchError as error:
        connection.send(Problem(_prefix(index) + str(error), is_bug=False))
    except OSError as error:  # a full disk, no permission
        connection.send(Problem(_prefix(index) + str(error), is_bug=False))
    except Exception:
        import traceback

        connection.send(Problem(_prefix(index) + traceback.format_exc(), is_bug=True))


def _load(task: Task) -> Renderer:
    import cv2

    cv2.setNumThreads(1)
    module, _, attribute = task.source.partition(":")
    return getattr(import_module(module), attribute)(task.config)


def _render(renderer: Renderer, index: int, dataset: Path, connection: Connection) -> None:
    from ..dataset import SequenceWriter

    rendered = renderer.render(index)
    with SequenceWriter(
        dataset, index, rendered.depth_unit, rendered.coordinate_box
    ) as writer:
        for frame in rendered.frames:
            writer.add(frame)
            connection.send(FrameDone())
        # With the sequence, so that the dataset's sum follows from what is on disk.
        seen = {**rendered.meta.observability, "refused": dict(rendered.refused)}
        writer.finish(replace(rendered.meta, observability=seen), rendered.state)


def _end_with_parent() -> None:
    """Ends this process at once when the parent is gone, whatever it died of."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)  # nothing to tidy up: unfinished files have temporary names


def _prefix(index: int | None) -> str:
    return "" if index is None else f"sequence {index:06d}: "
