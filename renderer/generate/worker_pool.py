"""Sequences rendered by worker processes: progress, and what happens when a process dies."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass

from ...errors import RenderError
from ..runtime import Problem, WorkerPool, WorkerSettings
from .worker_process import FrameDone, Message, ModelLoaded, RenderTask, SequenceDone

LIFETIME = 50
"""Sequences of one process: drivers and decoders leak memory."""
_MAX_LOST = 3  # sequences lost for good, after which the others are not tried


@dataclass(frozen=True)
class WorkerDied:
    """A process ended by itself, for example by a segmentation fault or for lack of memory."""

    notice: str
    """One line."""
    frames: int
    """Frames that were reported as done and are lost."""


def render_in_workers(
    task: RenderTask, indices: list[int], workers: int, lifetime: int = LIFETIME
) -> Generator[Message | WorkerDied]:
    """Render sequences in order with several processes at a time, and yield what happens.

    A sequence whose process dies is tried once more; if it dies again, RenderError is raised after
    the other sequences are rendered. Close the iterator to stop at once: no process outlives it.
    RuntimeError has the traceback of a bug in a worker.
    """
    settings = WorkerSettings(
        "gcbench.renderer.generate.worker_process:render_tasks", (task,), workers, lifetime,
        environment=dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"),
                                  "1"),  # the processes are the parallelism
    )
    pool = WorkerPool(settings, indices)
    deaths, frames, lost = Counter[int | None](), Counter[int | None](), list[str]()
    with closing(pool.events()) as events:
        for event in events:
            index, message = event.worker.task, event.content
            if event.kind == "died":
                where = "a worker {} before its first sequence" if index is None \
                    else f"sequence {index:06d}: its worker {{}}"
                notice = where.format(message)
                deaths[index] += 1
                again = deaths[index] == 1
                yield WorkerDied(f"{notice}{'; tried once more' if again else ', again; given up'}",
                                 frames.pop(index, 0))
                if again and index is not None:
                    pool.todo.appendleft(index)
                elif not again:
                    lost.append(notice)
                    if index is None or len(lost) >= _MAX_LOST:
                        pool.todo.clear()
                continue
            if isinstance(message, Problem):
                message.throw()
            yield message
            if isinstance(message, ModelLoaded):
                del deaths[None]  # processes do start
            if isinstance(message, FrameDone):
                frames[index] += 1
            elif isinstance(message, ModelLoaded | SequenceDone):
                event.worker.release()
    if lost:
        raise RenderError("; ".join(lost) + "; the same command tries again")
