"""Methods in processes of their own, with a time limit: what one does to itself costs the run a
sequence, never more."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import tempfile
import time
from collections import deque
from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from itertools import count
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from ...errors import GcbenchError
from ...renderer.runtime import uninterrupted
from ..methods import Declaration
from ..results import MAX_REASON, Status, Stored, dump_stored
from .method_worker import DONE, PROBLEM, READY, STARTED, THREADS, Task, work

START_LIMIT = 600.0
"""s for a method to load, or a sequence to be read: more means that the machine is stuck."""
LIFETIME = 200
"""Sequences of one process; what a method leaks ends with it."""
_MAX_ANSWER = 2**28


@dataclass
class _Worker:
    process: SpawnProcess
    connection: Connection
    log: Path
    deadline: float
    task: Task | None = None
    ready: bool = False
    started: bool = False
    finished: int = 0


def ask(source: str) -> Declaration:
    """What a method declares; it is loaded in a process of its own.

    Raises GcbenchError if it cannot be loaded.
    """
    with _logs() as logs:
        worker = _start(source, 1, logs / "0")
        try:
            if not worker.connection.poll(START_LIMIT):
                raise GcbenchError(f"{source}: did not load within {START_LIMIT:g} s")
            answer = worker.connection.recv_bytes(_MAX_ANSWER)
        except (EOFError, OSError) as error:
            raise GcbenchError(f"{source}: {_fate(worker)} while it loaded") from error
        finally:
            _kill(worker)
    if answer[:1] == PROBLEM:
        raise GcbenchError(answer[1:].decode(errors="replace"))
    tree: dict[str, Any] = json.loads(answer[1:])
    tree |= {name: tuple(tree[name]) for name in ("inputs", "knowledge")}
    return Declaration(**tree)


def run(
    source: str, tasks: Sequence[Task], workers: int, threads: int, timeout: float
) -> Generator[tuple[Task, bytes]]:
    """Each task with its estimate's ZIP (estimates.py), as they finish; failures are estimates too.

    `timeout` (s) is for `estimate` alone. Close the iterator to stop at once: no process outlives
    it. Raises GcbenchError if the method cannot be loaded or the data cannot be read.
    """
    todo, crew, number = deque(tasks), list[_Worker](), count()
    resource_tracker.ensure_running()  # its start would undo uninterrupted
    with _logs() as logs:
        try:
            while todo or any(w.task for w in crew):
                while len(crew) < min(workers, len(todo) + sum(w.task is not None for w in crew)):
                    crew.append(_start(source, threads, logs / str(next(number))))
                soonest = min(w.deadline for w in crew)
                talking = wait(
                    [w.connection for w in crew], max(0.0, min(soonest - time.monotonic(), 3600.0))
                )
                for worker in list(crew):
                    if worker.connection in talking:
                        done = _listen(worker, timeout)
                    elif time.monotonic() >= worker.deadline:
                        done = _late(worker, timeout)
                    else:
                        continue
                    task = worker.task
                    if done is not None and task is not None:
                        worker.task, worker.started = None, False
                        worker.finished += 1
                        yield task, done
                    if worker.connection.closed or worker.finished >= LIFETIME:
                        crew.remove(worker)
                        _kill(worker)
                    elif worker.ready and worker.task is None:
                        if todo:
                            _hand(worker, todo.popleft())
                        else:
                            crew.remove(worker)
                            _kill(worker)
        finally:
            for worker in crew:
                _kill(worker)


def _listen(worker: _Worker, timeout: float) -> bytes | None:
    """Take a message in; a ZIP if the task is over with it."""
    try:
        message = worker.connection.recv_bytes(_MAX_ANSWER)
    except (EOFError, OSError) as error:
        how = _fate(worker)
        if worker.task is None or not worker.started:
            raise GcbenchError(f"{how} before it began to estimate") from error
        worker.connection.close()
        return _failure("crashed", how)
    kind, content = message[:1], message[1:]
    if kind == PROBLEM:
        where = f"sequence {worker.task.sequence}: " if worker.task else ""
        raise GcbenchError(where + content.decode(errors="replace"))
    if kind == READY:
        worker.ready = True
        worker.deadline = time.monotonic() + START_LIMIT
    elif kind == STARTED:
        worker.started = True
        worker.deadline = time.monotonic() + timeout
    elif kind == DONE:
        worker.deadline = time.monotonic() + START_LIMIT
        return content
    return None


def _late(worker: _Worker, timeout: float) -> bytes:
    if not worker.started:
        raise GcbenchError(f"a worker did not begin to estimate within {START_LIMIT:g} s")
    said = _last_words(worker)
    _kill(worker)
    return _failure("timeout", f"no estimate within {timeout:g} s{said}")


def _failure(status: Status, reason: str) -> bytes:
    return dump_stored(Stored(status, reason))


def _hand(worker: _Worker, task: Task) -> None:
    worker.task, worker.started = task, False
    worker.deadline = time.monotonic() + START_LIMIT
    with suppress(OSError):
        os.truncate(worker.log, 0)
    with suppress(OSError):  # it is dead, which the next receive will find
        worker.connection.send_bytes(json.dumps(asdict(task)).encode())


def _start(source: str, threads: int, log: Path) -> _Worker:
    context = multiprocessing.get_context("spawn")
    with uninterrupted(), _environment(dict.fromkeys(THREADS, str(threads))):
        mine, its = context.Pipe()
        process = context.Process(target=work, args=(its, source, threads, str(log)))
        process.start()
        its.close()  # now the end of the process is the end of the connection
    return _Worker(process, mine, log, time.monotonic() + START_LIMIT)


def _kill(worker: _Worker) -> None:
    """Ends the process, and what it has started."""
    pid = worker.process.pid
    if pid is not None and worker.process.is_alive():
        with suppress(ProcessLookupError, PermissionError):
            if os.getpgid(pid) == pid:
                os.killpg(pid, signal.SIGKILL)
        worker.process.kill()
    worker.process.join()
    if not worker.connection.closed:
        worker.connection.close()


def _fate(worker: _Worker) -> str:
    worker.process.join(10.0)
    code = worker.process.exitcode
    how = f"exited with {code}"
    if code is None:
        how = "closed its connection"
    elif code < 0:
        with suppress(ValueError):
            how = f"was killed by {signal.Signals(-code).name}"
        how += " (out of memory?)" if code == -signal.SIGKILL else ""
    return f"the method's process {how}{_last_words(worker)}"


def _last_words(worker: _Worker) -> str:
    """What it printed last, on lines of their own."""
    with suppress(OSError), worker.log.open("rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - MAX_REASON // 2))
        said = file.read().decode(errors="replace").strip()
        return f"; it said:\n{said}" if said else ""
    return ""


@contextmanager
def _logs() -> Generator[Path]:
    with tempfile.TemporaryDirectory(prefix="gcbench-") as folder:
        yield Path(folder)


@contextmanager
def _environment(values: dict[str, str]) -> Generator[None]:
    """Variables for what is started in the block; those that the user has set stay."""
    mine = {k: v for k, v in values.items() if k not in os.environ}
    os.environ.update(mine)
    try:
        yield
    finally:
        for key in mine:
            del os.environ[key]
