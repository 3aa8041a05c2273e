"""Run methods in separate processes with limits; a hang or crash fails only one sequence.

Messages are bytes, so no output of a method is unpickled (see method_worker.py).
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import islice
from multiprocessing.connection import Connection
from typing import Generic, TypeVar

from ...errors import DatasetError, MethodError
from ...renderer.runtime import WorkerPool, WorkerSettings, to_record
from ...renderer.types import Observation
from ..methods import Declaration, is_own
from ..protocol import Allocate
from ..results import EstimateShape, Status, Stored, dump_stored
from .handover import Sender
from .method_worker import DONE, PROBLEM, READY, STARTED

Task = TypeVar("Task")
Observe = Callable[[Task, Allocate], tuple[Observation, EstimateShape]]
START_LIMIT = 600.0
"""Time limit for loading a method, s."""
_LIFETIME = 200
"""Sequences per process, because methods may leak memory."""
_MOST_FAILED_LOADS = 3
"""In a row, of a method that loaded before."""
_MAX_ANSWER = 2**28
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_WAIT_BRIEFLY = {"GOMP_SPINCOUNT": "1000"}
"""Threads of OpenMP that wait awake for long slow a method down tenfold where other programs run;
threads that sleep at once slow it down where none do."""


@dataclass(frozen=True)
class Limits:
    """What the processes of a method may use."""

    workers: int = 1
    """Number of parallel processes."""
    threads: int = 1
    """Number of threads per process."""
    timeout: float = 300.0
    """Time limit of `estimate`, s."""
    memory: float = 0.0
    """Private memory of each process, GiB; 0: no limit."""
    python: str = ""
    """Interpreter for methods that are not gcbench's; empty: that of this process."""


def read_declaration(source: str, limits: Limits) -> Declaration:
    """Load a method in a separate process and return its declaration, or raise MethodError."""
    pool = WorkerPool[None](_settings(source, limits), [None], receive=_receive)
    with closing(pool.events()) as events:
        event = next(events)
        said = event.worker.last_output()
    if event.kind == "late":
        raise MethodError(f"{source}: did not load within {START_LIMIT:g} s{said}")
    if event.kind == "died":
        raise MethodError(f"{source}: the method's process {event.content} while it loaded{said}")
    answer: bytes = event.content
    if answer[:1] == PROBLEM:
        raise MethodError(answer[1:].decode(errors="replace"))
    try:
        return to_record(json.loads(answer[1:]), Declaration, source, error=MethodError)
    except (ValueError, MethodError) as error:
        raise MethodError(f"{source}: its process sent no declaration") from error


def run_method(
    source: str, todo: deque[Task], observe: Observe[Task], limits: Limits
) -> Generator[tuple[Task, bytes]]:
    """Yield each finished task with the ZIP of its stored estimate (results/estimates.py).

    A failure is yielded as a stored estimate too. Closing the iterator ends all processes.
    `observe` reads the observation of a task in this process; its large arrays come from the
    function given to it. Tasks may be appended to `todo` between two that are yielded. Raises
    MethodError if the method cannot be loaded; once it has been, only after several attempts.
    """
    sender = Sender(limits.workers)
    reader = _Reader(lambda task: observe(task, sender.allocate), todo, limits.workers)
    pool = WorkerPool[Task](_settings(source, limits), todo, partial(_send, sender, reader),
                            _receive)
    started: set[Task] = set()
    problems: dict[Task, str] = {}
    was_ready, failed_loads = False, 0
    with closing(reader), closing(pool.events()) as events:
        for event in events:
            worker, task = event.worker, event.worker.task
            if event.kind != "message":
                how = f"the method's process {event.content}"
                said = worker.last_output()
                if task is None:
                    failed_loads += 1
                    if was_ready and failed_loads < _MOST_FAILED_LOADS:
                        continue  # such as a lack of memory, which may pass
                    late = f"{source}: a process did not load within {START_LIMIT:g} s"
                    raise MethodError(late if event.kind == "late" else
                                      f"{source}: {how} while it loaded{said}")
                if event.kind == "died":
                    yield task, _failure("crashed", problems.get(task, how) + said)
                else:
                    late = f"no estimate within {limits.timeout:g} s{said}"
                    yield task, _failure("timeout", late)
                continue
            kind, content = event.content[:1], event.content[1:]
            if kind == PROBLEM:  # the last message of a process
                text = content.decode(errors="replace")
                if task is not None:
                    problems[task] = text
                elif not was_ready:
                    raise MethodError(text)
            elif kind == STARTED and task is not None and task not in started:
                started.add(task)
                worker.allow(limits.timeout)
            elif kind in (READY, DONE):
                was_ready, failed_loads = True, 0
                worker.release()
                if task is not None:
                    yield task, content


class _Reader(Generic[Task]):
    """Reads observations; with several workers, ahead of them and in a thread."""

    def __init__(
        self, observe: Callable[[Task], tuple[Observation, EstimateShape]], todo: deque[Task],
        workers: int,
    ) -> None:
        self._observe, self._todo = observe, todo
        self._ahead = workers if workers > 1 else 0
        self._threads = ThreadPoolExecutor(1)
        self._ready: dict[Task, Future[tuple[Observation, EstimateShape]]] = {}

    def read(self, task: Task) -> tuple[Observation, EstimateShape]:
        future = self._ready.pop(task, None)
        found = future.result() if future else self._observe(task)
        for following in islice(self._todo, self._ahead):
            if following not in self._ready:
                self._ready[following] = self._threads.submit(self._observe, following)
        return found

    def close(self) -> None:
        self._threads.shutdown(cancel_futures=True)


def _settings(source: str, limits: Limits) -> WorkerSettings:
    python = "" if is_own(source) else limits.python
    return WorkerSettings(
        "gcbench.benchmark.run.method_worker:serve", (source, limits.threads, python),
        limits.workers, _LIFETIME, START_LIMIT,
        {**dict.fromkeys(_THREADS, str(limits.threads)), **_WAIT_BRIEFLY},
        foreign=True, memory=int(limits.memory * 2**30) or None,
    )


def _send(sender: Sender, reader: _Reader[Task], connection: Connection, task: Task) -> None:
    try:
        observation = sender.pack(*reader.read(task))
    except OSError as error:  # the pool takes one for the end of the process
        raise DatasetError(f"cannot hand over an observation: {error.strerror}") from error
    sender.send(connection, observation)


def _receive(connection: Connection) -> bytes:
    return connection.recv_bytes(_MAX_ANSWER)


def _failure(status: Status, reason: str) -> bytes:
    return dump_stored(Stored(status, reason))
