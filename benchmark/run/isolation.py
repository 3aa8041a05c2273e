"""Run methods in separate processes with a time limit; a hang or crash fails only one sequence.

Messages are bytes, so no output of a method is unpickled (see method_worker.py).
"""

from __future__ import annotations

import json
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import asdict
from multiprocessing.connection import Connection
from typing import Any

from ...errors import MethodError
from ...renderer.runtime import WorkerPool, WorkerSettings
from ..methods import Declaration
from ..results import Status, Stored, dump_stored
from .method_worker import DONE, PROBLEM, READY, STARTED, Task

START_LIMIT = 600.0
"""Time limit for loading a method or reading a sequence, s."""
_LIFETIME = 200
"""Sequences per process, because methods may leak memory."""
_MAX_ANSWER = 2**28
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def read_declaration(source: str) -> Declaration:
    """Load a method in a separate process and return its declaration.

    Raises:
        MethodError: If it cannot be loaded.
    """
    with closing(_pool(source, [None], 1, 1).events()) as events:
        event = next(events)
    if event.kind == "late":
        raise MethodError(f"{source}: did not load within {START_LIMIT:g} s")
    if event.kind == "died":
        said = event.worker.last_words()
        raise MethodError(f"{source}: the method's process {event.content} while it loaded{said}")
    answer: bytes = event.content
    if answer[:1] == PROBLEM:
        raise MethodError(answer[1:].decode(errors="replace"))
    tree: dict[str, Any] = json.loads(answer[1:])
    tree |= {name: tuple(tree[name]) for name in ("inputs", "knowledge")}
    return Declaration(**tree)


def run(
    source: str, tasks: Sequence[Task], workers: int, threads: int, timeout: float
) -> Generator[tuple[Task, bytes]]:
    """Yield each finished task with the ZIP of its stored estimate (results/estimates.py).

    A failure is yielded as a stored estimate too. Closing the iterator ends all processes.

    Args:
        source: Name or source of the method.
        tasks: The sequences to estimate, with the row of each.
        workers: Number of parallel processes.
        threads: Number of threads per process.
        timeout: Time limit of `estimate`, s.

    Raises:
        MethodError: If the method cannot be loaded or the data cannot be read.
    """
    started: set[Task] = set()
    with closing(_pool(source, tasks, workers, threads).events()) as events:
        for event in events:
            worker, task = event.worker, event.worker.task
            if event.kind != "message":
                how = f"the method's process {event.content}"
                if task is None or task not in started:
                    raise MethodError(
                        f"{how}{worker.last_words()} before it began to estimate"
                        if event.kind == "died" else
                        f"a worker did not begin to estimate within {START_LIMIT:g} s"
                    )
                if event.kind == "died":
                    yield task, _failure("crashed", how + worker.last_words())
                else:
                    said = worker.last_words()
                    yield task, _failure("timeout", f"no estimate within {timeout:g} s{said}")
                continue
            kind, content = event.content[:1], event.content[1:]
            if kind == PROBLEM:
                where = f"sequence {task.sequence}: " if task else ""
                raise MethodError(where + content.decode(errors="replace"))
            if kind == STARTED and task is not None:
                started.add(task)
                worker.allow(timeout)
            elif kind in (READY, DONE):
                worker.release()
                if task is not None:
                    yield task, content


def _pool(
    source: str, tasks: Sequence[Task | None], workers: int, threads: int
) -> WorkerPool[Task | None]:
    settings = WorkerSettings(
        "gcbench.benchmark.run.method_worker:serve", (source, threads), workers, _LIFETIME,
        START_LIMIT, dict.fromkeys(_THREADS, str(threads)), foreign=True,
    )
    return WorkerPool(settings, tasks, _send, lambda connection: connection.recv_bytes(_MAX_ANSWER))


def _send(connection: Connection, task: Task | None) -> None:
    if task is not None:
        connection.send_bytes(json.dumps(asdict(task)).encode())


def _failure(status: Status, reason: str) -> bytes:
    return dump_stored(Stored(status, reason))
