"""Worker processes that share a list of tasks: start, hand out, time limits, deaths, restarts.

The pool does not depend on the kind of work. A target "module:function" runs in each process as
`function(connection, *arguments)`: it receives tasks from its connection and sends messages, until
the connection ends. The caller decides what a message is: pickled records between our own
processes, or bytes where the process runs foreign code. No process outlives the iterator of
`WorkerPool.events`, nor the parent.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module
from itertools import count
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, Literal, TypeVar

from ...errors import ConfigError
from ...robots.files import scratch_folder
from .interrupt import defer_interrupts
from .worker_output import WorkerLog

_Task = TypeVar("_Task")
_Received = TypeVar("_Received")
_LOOK_AT_LOGS = 0.25  # s
_FOLDER = ".gcbench-pool-"
"""Beginning of the name of a temporary folder. Datasets have locks too, but not such names."""
_LONGEST_WAIT = 3600.0  # s
_is_worker = False


@dataclass(frozen=True)
class WorkerSettings:
    """How a pool runs its processes."""

    target: str
    """"module:function", called in each process with its connection and `arguments`."""
    arguments: tuple[Any, ...] = ()
    workers: int = 1
    """Processes at a time."""
    lifetime: int = 100
    """Tasks of one process. A new process has none of the memory that the old one leaked."""
    start_limit: float = math.inf
    """s for a process to get ready, and to report that it began a task."""
    environment: Mapping[str, str] = field(default_factory=dict[str, str])
    """Variables of the processes. Those that the user has set take precedence."""
    foreign: bool = False
    """The target runs foreign code: what it starts ends with it, what it prints goes to a file, its
    temporary files go to a folder of the pool (see supervisor.py)."""
    memory: int | None = None
    """Largest private memory of a process of foreign code, bytes."""


@dataclass(eq=False)
class Worker(Generic[_Task]):
    """One process of a pool. The consumer of events calls `release` and `allow`."""

    process: SpawnProcess
    connection: Connection
    log: WorkerLog | None
    deadline: float
    task: _Task | None = None
    """What it works on."""
    is_idle: bool = False
    finished: int = 0
    """Tasks that it finished."""

    def release(self) -> None:
        """Mark the process as ready for a task, and its task as finished."""
        self.finished += self.task is not None
        self.task, self.is_idle = None, True

    def allow(self, seconds: float) -> None:
        """Set the time limit for the next message."""
        self.deadline = time.monotonic() + seconds

    def last_output(self) -> str:
        """Return what the process printed last, on lines of their own; only of foreign code."""
        said = "" if self.log is None else self.log.end()
        return f"; it said:\n{said}" if said else ""


@dataclass(frozen=True)
class Event(Generic[_Task]):
    """What happened to a worker."""

    worker: Worker[_Task]
    kind: Literal["message", "died", "late"]
    """late: the time limit is over. Workers that died or are late are removed from the pool."""
    content: Any = None
    """The message; how the process died, in words."""


class WorkerPool(Generic[_Task]):
    """Processes that work on `todo`, first to last."""

    def __init__(
        self,
        settings: WorkerSettings,
        tasks: Iterable[_Task],
        send: Callable[[Connection, _Task], None] = Connection.send,
        receive: Callable[[Connection], Any] = Connection.recv,
    ) -> None:
        """`send` and `receive` write a task to a connection and read a message from it.

        A deque of tasks is used itself: its owner may append to it while an event is handled.
        """
        self.settings, self.todo = settings, tasks if isinstance(tasks, deque) else deque(tasks)
        self._send, self._receive = send, receive
        self._workers = list[Worker[_Task]]()
        self._number = count()

    def events(self) -> Generator[Event[_Task]]:
        """Yield what happens until every task is finished or lost.

        Close the iterator to stop at once. A task whose process ended is lost unless the consumer
        appends it to `todo` again.
        """
        if _is_worker:
            raise ConfigError("a script starts worker processes while one of them imports it; "
                              'put its calls of gcbench below `if __name__ == "__main__":`')
        resource_tracker.ensure_running()  # its start would undo defer_interrupts
        with scratch_folder(Path(tempfile.gettempdir()), _FOLDER) as logs:
            try:
                while self.todo or self._busy():
                    while len(self._workers) < min(
                        self.settings.workers, len(self.todo) + self._busy()
                    ):
                        self._workers.append(self._start(logs))
                    for event in self._next_events():
                        if event.kind != "message":
                            self._workers.remove(event.worker)
                            _kill(event.worker)
                            _join(event.worker)
                        yield event
                        if event.kind == "message" and event.worker.is_idle:
                            self._hand_out(event.worker)
            finally:
                for worker in self._workers:
                    _kill(worker)
                for worker in self._workers:
                    _join(worker)
                self._workers.clear()

    def _busy(self) -> int:
        return sum(worker.task is not None for worker in self._workers)

    def _next_events(self) -> Generator[Event[_Task]]:
        """Wait for the next message, death or deadline."""
        limit = min(worker.deadline for worker in self._workers) - time.monotonic()
        most = _LOOK_AT_LOGS if self.settings.foreign else _LONGEST_WAIT
        ready = wait([worker.connection for worker in self._workers], max(0.0, min(limit, most)))
        for worker in list(self._workers):
            if worker.log is not None:
                worker.log.shorten()
            if worker.connection in ready:
                try:
                    yield Event(worker, "message", self._receive(worker.connection))
                except (EOFError, OSError):
                    yield Event(worker, "died", _describe_end(worker.process))
            elif time.monotonic() >= worker.deadline:
                yield Event(worker, "late")

    def _hand_out(self, worker: Worker[_Task]) -> None:
        """Give an idle worker its next task, or end it."""
        if not self.todo or worker.finished >= self.settings.lifetime:
            self._workers.remove(worker)
            worker.connection.close()  # the process ends when it has read that
            if not self.settings.foreign:
                worker.process.join(10.0)  # a driver may hang
            _kill(worker)
            _join(worker)
            return
        worker.task, worker.is_idle = self.todo.popleft(), False
        worker.allow(self.settings.start_limit)
        if worker.log is not None:
            worker.log.clear()
        with suppress(OSError):  # it is dead, which the next receive finds
            self._send(worker.connection, worker.task)

    def _start(self, logs: Path) -> Worker[_Task]:
        s = self.settings
        log = None
        if s.foreign:
            log = WorkerLog(logs / str(next(self._number)) / "output")
            log.path.parent.mkdir()
        context: SpawnContext = multiprocessing.get_context("spawn")
        with hide_main(), defer_interrupts(), _variables(s.environment), _arguments(not s.foreign):
            mine, its = context.Pipe()
            process = context.Process(
                target=_main, args=(its, s.target, s.arguments, log, s.memory),
                daemon=not s.foreign,
            )
            process.start()
            its.close()  # now the end of the process is the end of the connection
        return Worker(process, mine, log, time.monotonic() + s.start_limit)


def _kill(worker: Worker[Any]) -> None:
    """Kill the process, and what foreign code in it has started."""
    if worker.log is not None:
        worker.process.terminate()  # the supervisor kills what it started
        worker.process.join(10.0)
    worker.process.kill()


def _join(worker: Worker[Any]) -> None:
    worker.process.join()
    worker.connection.close()


def _describe_end(process: SpawnProcess) -> str:
    process.join(10.0)
    code = process.exitcode
    if code is None:
        return "closed its connection"
    if code >= 0:
        return f"exited with {code}"
    try:
        how = f"was killed by {signal.Signals(-code).name}"
    except ValueError:
        how = f"was killed by signal {-code}"
    return how + (" (out of memory?)" if code == -signal.SIGKILL else "")


@contextmanager
def hide_main() -> Generator[None]:
    """Processes that are started in the block do not run the script of this one again.

    So a script may call gcbench outside of `if __name__ == "__main__":`, or come from stdin.
    """
    mine = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = mine


@contextmanager
def _variables(values: Mapping[str, str]) -> Generator[None]:
    """Environment variables for what is started in the block; those already set stay.

    Libraries read them when they load, which happens before the target runs.
    """
    mine = {k: v for k, v in values.items() if k not in os.environ}
    os.environ.update(mine)
    try:
        yield
    finally:
        for key in mine:
            del os.environ[key]


@contextmanager
def _arguments(shown: bool) -> Generator[None]:
    """Without those of the command line for what is started in the block, unless `shown`."""
    mine = sys.argv
    sys.argv = mine if shown else mine[:1]
    try:
        yield
    finally:
        sys.argv = mine


def cpu_count() -> int:
    """Return the number of CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def count_workers(requested: int | None) -> int:
    """Return the number of processes that were asked for; 0 and None are one for each core.

    Raises ConfigError for a negative number.
    """
    if requested is not None and requested < 0:
        raise ConfigError(f"--workers {requested}: give 1 or more, or 0 for one for each core")
    return requested or cpu_count()


# -- in the process ---------------------------------------------------------------------------


def receive_tasks(
    connection: Connection, receive: Callable[[Connection], _Received]
) -> Generator[_Received]:
    """Yield what `receive` reads from a connection, until the parent closes it."""
    with suppress(EOFError):
        while True:
            yield receive(connection)  # a name would keep a task in memory


def _main(
    connection: Connection, target: str, arguments: tuple[Any, ...], log: WorkerLog | None,
    memory: int | None,
) -> None:
    """The main function of the process."""
    global _is_worker
    _is_worker = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; the parent decides
    if log is not None:
        from .supervisor import supervise

        os.setsid()  # Ctrl-C does not reach it
        log.redirect()
        os.environ["TMPDIR"], tempfile.tempdir = str(log.path.parent), None
        supervise(connection, memory, _wait_for_parent)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    module, _, function = target.partition(":")
    with suppress(EOFError, BrokenPipeError):  # the parent closed the connection
        getattr(import_module(module), function)(connection, *arguments)


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()


def _end_with_parent() -> None:
    """End this process at once when its parent ends, for whatever reason."""
    _wait_for_parent()
    os._exit(1)  # unfinished files have temporary names: nothing to tidy up
