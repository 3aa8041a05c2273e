"""A process between the pool and foreign code: it ends everything that this code has started.

    pool -> supervisor -> foreign code -> its children

On Linux the supervisor is a sub-reaper: a process whose parent has ended becomes its child, also
one in a session of its own. When the foreign code ends, or the pool says so by SIGTERM, the
supervisor kills all of its descendants, and then ends as the foreign code did.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
import resource
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NoReturn

_SUBREAPER, _DEATH_SIGNAL = 36, 1  # of prctl
_END_LIMIT = 5.0  # s


def supervise(
    connection: Connection, memory: int | None, wait_for_pool: Callable[[], None]
) -> None:
    """Fork, and return in the child, which runs the foreign code; this process never returns.

    The supervisor closes the connection. `memory` limits the private memory of each process, bytes;
    `wait_for_pool` returns when the pool's process has ended.
    """
    _prctl(_SUBREAPER, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of threads of NumPy, which survives a fork
        child = os.fork()
    if child == 0:
        os.setsid()
        die_with_parent()
        if memory is not None:
            resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
        return
    connection.close()

    def end(code: int) -> None:
        _kill_descendants(child)
        os._exit(code)

    def end_with_pool() -> None:
        wait_for_pool()
        end(1)

    signal.signal(signal.SIGTERM, lambda _, __: end(1))
    threading.Thread(target=end_with_pool, daemon=True).start()
    ended = status = 0
    while ended != child:
        ended, status = os.waitpid(-1, 0)
    _kill_descendants(child)
    end_like(os.waitstatus_to_exitcode(status))


def end_like(code: int) -> NoReturn:
    """End this process at once as another one did: exit with `code`, or die of signal -`code`."""
    if code < 0:
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with suppress(OSError):
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


def die_with_parent() -> None:
    """Have the system kill this process when the one that started it ends (Linux)."""
    _prctl(_DEATH_SIGNAL, signal.SIGKILL)


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _kill_descendants(session: int) -> None:
    """Kill until no child is left: the children of a killed process become our own."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(session, signal.SIGKILL)
    limit = time.monotonic() + _END_LIMIT
    while time.monotonic() < limit:
        try:
            if os.waitpid(-1, os.WNOHANG)[0]:
                continue
        except ChildProcessError:
            return
        for child in _children():
            with suppress(ProcessLookupError, PermissionError):
                os.kill(child, signal.SIGKILL)
        time.sleep(0.001)


def _children() -> list[int]:
    """Return the children of this process, as /proc lists them."""
    found: list[int] = []
    with suppress(OSError):
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError, IndexError):
                if int((folder / "stat").read_text().rpartition(")")[2].split()[1]) == os.getpid():
                    found.append(int(folder.name))
    return found
