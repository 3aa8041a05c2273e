"""Faults of the disk and kills, at the n-th change of a file that a command makes.

A change is a call that opens a file for writing, writes to it, flushes it to the disk, renames,
deletes or makes a folder; those of worker processes count too. Libraries in C that write files by
themselves are not seen.
"""

from __future__ import annotations

import builtins
import errno
import io
import mmap
import os
import signal
import struct
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

Fault = Literal["kill", "full", "read-only"]
_ERRORS = {"full": errno.ENOSPC, "read-only": errno.EROFS}
_FREE = ("os.remove", "os.rmdir", "os.rename")  # possible on a full disk
_EVENTS = {
    "os.rename": 0,
    "os.remove": 0,
    "os.rmdir": 0,
    "os.mkdir": 0,
    "os.truncate": 0,
    "os.link": 1,
    "os.symlink": 1,
}  # number of the argument that is changed


@dataclass
class Schedule:
    """A fault from the n-th change on. Installed in the command's process; workers inherit it."""

    fault: Fault
    at: int
    folders: tuple[Path, ...]
    """Changes below these folders count."""
    _shared: mmap.mmap = field(default_factory=lambda: mmap.mmap(-1, 16))
    """Changes so far, and the command's process."""
    _busy: bool = False

    @property
    def count(self) -> int:
        """Changes that were made or tried."""
        return struct.unpack("<q", self._shared[:8])[0]

    def install(self) -> None:
        """Watch this process from now on."""
        self._shared[8:] = struct.pack("<q", os.getpid())
        sys.addaudithook(self._audit)
        flush = os.fsync

        def fsync(file: int) -> None:
            self.change("os.fsync", f"/proc/self/fd/{file}")
            flush(file)

        os.fsync = fsync  # type: ignore[assignment]
        builtins.open = io.open = self._open  # type: ignore[assignment]

    def change(self, what: str, path: Any) -> None:
        """Count a change; bring the fault about if its time has come."""
        if isinstance(path, int) or self._busy:
            return
        self._busy = True
        try:
            real = Path(os.path.realpath(os.fsdecode(path)))
        finally:
            self._busy = False
        if not any(real.is_relative_to(folder) for folder in self.folders):
            return
        number, process = struct.unpack("<qq", self._shared[:16])
        self._shared[:8] = struct.pack("<q", number + 1)
        if number + 1 < self.at or (self.fault == "full" and what in _FREE):
            return
        if self.fault == "kill":
            os.killpg(process, signal.SIGKILL)
            os.kill(os.getpid(), signal.SIGKILL)  # a process of a session of its own
        code = _ERRORS[self.fault]
        raise OSError(code, os.strerror(code), os.fsdecode(path))

    def _audit(self, event: str, args: tuple[Any, ...]) -> None:
        if event == "open":
            if args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND):
                self.change(event, args[0])
        elif event in _EVENTS:
            self.change(event, args[_EVENTS[event]])

    def _open(
        self,
        file: Any,
        mode: str = "r",
        buffering: int = -1,
        encoding: str | None = None,
        errors: str | None = None,
        newline: str | None = None,
        closefd: bool = True,
        opener: Any = None,
    ) -> Any:
        """`open`, with a raw file that counts what is written."""
        if not {*mode} & {*"wax+"}:
            return _OPEN(file, mode, buffering, encoding, errors, newline, closefd, opener)
        raw = _RawFile(self, file, mode.replace("b", "").replace("t", ""), closefd, opener)
        if buffering == 0:
            return raw
        size = buffering if buffering > 1 else io.DEFAULT_BUFFER_SIZE
        buffer = io.BufferedRandom(raw, size) if "+" in mode else io.BufferedWriter(raw, size)
        if "b" in mode:
            return buffer
        text = io.TextIOWrapper(buffer, encoding, errors, newline, buffering == 1)
        text.mode = mode  # type: ignore[misc]
        return text


_OPEN = io.open


class _RawFile(io.FileIO):
    """A file whose writes count; a kill leaves half of a block behind."""

    def __init__(self, schedule: Schedule, *args: Any) -> None:
        super().__init__(*args)
        self._schedule = schedule

    def write(self, data: Any, /) -> int:
        half = len(data) // 2
        if (
            half
            and self._schedule.fault == "kill"
            and self._schedule.count + 1 == self._schedule.at
        ):
            super().write(memoryview(data)[:half])
        self._schedule.change("write", self.name)
        return super().write(data)
