"""Worker processes that share a list of sequences, and what happens when one of them dies."""

from __future__ import annotations

import multiprocessing
import signal
from collections import Counter, deque
from collections.abc import Generator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from ...errors import GcbenchError
from ..runtime import uninterrupted
from .worker_process import FrameDone, Problem, Ready, SequenceDone, Task, work

LIFETIME = 50
"""Sequences of one process; drivers and decoders leak, a new process does not remember."""
_HOPELESS = 3  # sequences lost for good, after which the others are not tried


@dataclass(frozen=True)
class Died:
    """A process ended by itself, as of a segmentation fault or the system's want of memory."""

    notice: str
    """One line."""
    frames: int
    """Reported as done, and lost."""


@dataclass
class _Worker:
    process: SpawnProcess
    connection: Connection
    index: int | None = None
    """What it is rendering."""
    frames: int = 0
    """Of that."""
    finished: int = 0
    """Sequences."""


def crew(
    task: Task, indices: list[int], workers: int
) -> Generator[Ready | FrameDone | SequenceDone | Died]:
    """Render `indices` in order with so many processes at a time, and tell how it goes.

    A sequence whose process dies is tried once more. Close the iterator to stop at once: no
    process outlives it. Raises GcbenchError if the model or a sequence cannot be rendered (when
    processes die, at the end: the other sequences are rendered first), RuntimeError with the
    worker's traceback for a bug.
    """
    todo = deque(indices)
    deaths: Counter[int | None] = Counter()
    lost: list[str] = []
    crew: list[_Worker] = []
    resource_tracker.ensure_running()  # its start would undo uninterrupted
    try:
        while todo or any(w.index is not None for w in crew):
            while len(crew) < min(workers, len(todo) + sum(w.index is not None for w in crew)):
                with uninterrupted():
                    crew.append(_start(task))
            for worker in _talking(crew):
                try:
                    message = worker.connection.recv()
                except (EOFError, OSError):
                    crew.remove(worker)
                    died, index = _died(worker), worker.index
                    deaths[index] += 1
                    if deaths[index] == 1:
                        yield Died(f"{died}; tried once more", worker.frames)
                        if index is not None:
                            todo.appendleft(index)
                        continue
                    lost.append(died)
                    yield Died(f"{died}, again; given up", worker.frames)
                    if index is None or len(lost) >= _HOPELESS:
                        todo.clear()
                    continue
                if isinstance(message, Problem):
                    if message.is_bug:
                        raise RuntimeError(message.message)
                    raise GcbenchError(message.message)
                yield message
                if isinstance(message, FrameDone):
                    worker.frames += 1
                    continue
                if isinstance(message, SequenceDone):
                    worker.finished += 1
                worker.index, worker.frames = None, 0
                if todo and worker.finished < LIFETIME:
                    worker.index = todo.popleft()
                    _send(worker, worker.index)
                else:
                    crew.remove(worker)
                    _dismiss(worker)
    finally:
        for worker in crew:
            worker.process.kill()
        for worker in crew:
            worker.process.join()
            worker.connection.close()
    if lost:
        raise GcbenchError("; ".join(lost) + "; the same command tries again")


def _start(task: Task) -> _Worker:
    context = multiprocessing.get_context("spawn")
    mine, its = context.Pipe()
    process = context.Process(target=work, args=(its, task), daemon=True)
    process.start()
    its.close()  # now the end of the process is the end of the connection
    return _Worker(process, mine)


def _talking(crew: list[_Worker]) -> list[_Worker]:
    """Workers that have something to say, or have died; waits for the first."""
    ready = wait([worker.connection for worker in crew])
    return [worker for worker in crew if worker.connection in ready]


def _send(worker: _Worker, index: int | None) -> None:
    with suppress(OSError):  # it is dead, which the next receive will find
        worker.connection.send(index)


def _dismiss(worker: _Worker) -> None:
    """Ends a worker that is waiting for an index."""
    _send(worker, None)
    worker.process.join(10.0)
    worker.process.kill()  # one that hangs in a driver
    worker.process.join()
    worker.connection.close()


def _died(worker: _Worker) -> str:
    worker.process.join()
    worker.connection.close()
    code = worker.process.exitcode or 0
    try:
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"exited with {code}"
    except ValueError:
        how = f"was killed by signal {-code}"
    if code == -signal.SIGKILL:
        how += " (out of memory?)"
    if worker.index is None:
        return f"a worker {how} before its first sequence"
    return f"sequence {worker.index:06d}: its worker {how}"
