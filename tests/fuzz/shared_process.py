"""One process that runs many commands in turn, which costs a fraction of a process for each.

Here the workers that render are threads. A command finds what the commands before it left in the
memory of the process, except the caches of gcbench, which are emptied; so every tenth case of a
campaign runs in processes of its own (`sandbox.run`), and so does each case with a finding.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing.connection import Connection
from multiprocessing.context import ForkContext
from pathlib import Path
from typing import Any

from . import sandbox
from .sandbox import Command, Outcome, Sandbox

_COMMANDS = 60
"""Of one process. A new one has none of the memory that the old one collected."""


def may_share(command: Command) -> bool:
    """Whether a command runs in a process of others: no training, no second worker, no method."""
    words = " ".join(command.argv)
    one = words.count("--workers") == words.count("--workers 1")
    other = command.argv[:1] == ("train",) or "--suite" in words or "--workers=" in words
    return one and not (other or command.foreign or command.prepare)


@dataclass
class SharedProcess:
    """Runs commands in a forked process, which is replaced when it dies or has run many."""

    _pid: int = 0
    _connection: Connection | None = None
    _left: int = 0

    def run(self, command: Command, box: Sandbox) -> Outcome:
        """Run a command and check what it did."""
        if not self._left:
            self.close()
            self._start(box)
        self._left -= 1
        assert self._connection is not None
        started = time.monotonic()
        self._connection.send(command)
        late, status, memory, left = False, 0, 0.0, list[str]()
        try:
            late = not self._connection.poll(sandbox.WALL_SECONDS)
            if late:
                os.killpg(self._pid, signal.SIGKILL)
            status, memory, left = self._connection.recv()
        except (EOFError, OSError):
            ended, usage = os.wait4(self._pid, 0)[1:]
            status, memory = os.waitstatus_to_exitcode(ended), usage.ru_maxrss / 1024
            self._left = self._pid = 0
        left += [f"no end within {sandbox.WALL_SECONDS:g} s"] * late
        return sandbox.judge(command, box, (status, time.monotonic() - started, memory), left)

    def close(self) -> None:
        """End the process."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self._pid:
            os.waitpid(self._pid, 0)
            self._pid = 0

    def _start(self, box: Sandbox) -> None:
        self._connection, its = multiprocessing.Pipe()
        sys.stdout.flush()
        sys.stderr.flush()
        self._pid = os.fork()
        if not self._pid:
            self._connection.close()
            try:
                _serve(its, box)
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(70)
        its.close()
        self._left = _COMMANDS


# -- in the process -------------------------------------------------------------------------------


def _serve(requests: Connection, box: Sandbox) -> None:
    os.setsid()
    sandbox.adopt_orphans()
    sandbox.limit_memory()
    threads, get_context = _Threads(), multiprocessing.get_context
    multiprocessing.get_context = lambda method=None: (  # type: ignore[assignment]
        threads if method == "spawn" else get_context(method))
    auditor: sandbox.Auditor | None = None
    caches = _caches()
    environment = dict(os.environ)
    while True:
        try:
            command: Command = requests.recv()
        except EOFError:
            os._exit(0)
        before = sandbox.children()
        Path("/proc/self/clear_refs").write_text("5")  # forgets the peak of the memory
        used = resource.getrusage(resource.RUSAGE_SELF)
        seconds = int(used.ru_utime + used.ru_stime) + sandbox.CPU_SECONDS
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, resource.RLIM_INFINITY))
        sandbox.enter(box)
        if auditor is None:
            auditor = sandbox.Auditor(box)
            sys.addaudithook(auditor)
        auditor.command = command
        code = sandbox.call(command)
        auditor.command = None
        peak = Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]
        requests.send((code, int(peak) / 1024, sandbox.leftover_processes(before)))
        os.environ.clear()
        os.environ.update(environment)
        for clear in caches:
            clear()


def _caches() -> list[Callable[[], None]]:
    """What empties each cache of gcbench."""
    modules = [module for name, module in sys.modules.items() if name.startswith("gcbench.")]
    values = {id(v): v for module in modules for v in vars(module).values()}
    return [v.cache_clear for v in values.values() if callable(getattr(v, "cache_clear", None))]


class _Threads(ForkContext):
    """Threads where the package asks for its own fresh processes; forks for foreign code."""

    def __init__(self) -> None:
        self._forks = sandbox.Forks()

    def Pipe(self, duplex: bool = True) -> Any:  # noqa: N802
        return self._forks.Pipe(duplex)

    def Process(self, target: Any, args: Any, daemon: bool) -> Any:  # noqa: N802
        if not daemon:
            return self._forks.Process(target, args, daemon)
        return _Thread(args)


@dataclass
class _Thread:
    """A worker as a thread, with what the pool asks of a process."""

    arguments: Any
    exitcode: int | None = None
    _thread: threading.Thread = field(init=False)
    _connection: Connection = field(init=False)

    def start(self) -> None:
        its, target, arguments = self.arguments[:3]
        self._connection = Connection(os.dup(its.fileno()))
        self._thread = threading.Thread(target=self._run, args=(target, arguments))
        self._thread.daemon = True
        self._thread.start()

    def _run(self, target: str, arguments: Any) -> None:
        module, _, function = target.partition(":")
        with self._connection as connection, suppress(EOFError, BrokenPipeError):
            getattr(import_module(module), function)(connection, *arguments)
        self.exitcode = 0

    def join(self, timeout: float | None = None) -> None:
        self._thread.join(timeout)

    def kill(self) -> None:
        """End its connection, which ends it; a task that it works on is finished first."""
        with suppress(OSError), socket.socket(fileno=os.dup(self._connection.fileno())) as end:
            end.shutdown(socket.SHUT_RDWR)

    terminate = kill
