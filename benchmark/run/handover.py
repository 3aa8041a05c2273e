"""Hand observations to the processes of methods, in memory that only the sender can write.

The sender never waits for the receiver, which may be stopped. The receiver's arrays are copies on
write. As most of the cost is new memory, a sheet is used again, but only when the kernel says that
no other process has it open or mapped: no method sees a later observation in an earlier one, and an
array that a method keeps never changes.
"""

from __future__ import annotations

import dataclasses
import fcntl
import math
import mmap
import os
import tempfile
import threading
from collections import deque
from contextlib import suppress
from multiprocessing import reduction
from multiprocessing.connection import Connection
from typing import Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ...renderer.types import Observation
from ..results import EstimateShape

_SMALL = 2**12
"""Bytes; smaller arrays are sent by value."""
_SEAL_FUTURE_WRITE = 0x10
"""From <linux/fcntl.h>: what is mapped now can be written, but nothing can be mapped so again."""
_POPULATE_READ = 22
"""MADV_POPULATE_READ of <linux/mman.h>."""


class _Sheet(mmap.mmap):
    """A file without a name in memory, of fixed size, and its only writable mapping."""

    file: int
    sealed: bool

    def __del__(self) -> None:
        os.close(self.file)

    def is_unused(self) -> bool:
        """Whether no other open file or mapping of the sheet exists, in any process.

        A write lease is granted for no other file (fcntl(2)); in doubt the answer is False.
        """
        try:
            fcntl.fcntl(self.file, fcntl.F_SETLEASE, fcntl.F_WRLCK)
            fcntl.fcntl(self.file, fcntl.F_SETLEASE, fcntl.F_UNLCK)
        except OSError:
            return False
        return self.sealed


@dataclasses.dataclass(frozen=True)
class PackedObservation:
    """An observation in sheets: the first holds all but the large arrays."""

    sheets: tuple[_Sheet, ...]


class Sender:
    """Sends observations to methods. Threads may share it."""

    def __init__(self, workers: int) -> None:
        self._sent = deque[_Sheet](maxlen=4 * workers)  # rgb, depth, part and flow of each
        self._lock = threading.Lock()

    def allocate(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return an array for an observation, which is sent without a copy; its content is
        arbitrary. Raises OSError."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if size < _SMALL:
            return np.empty(shape, dtype)
        with self._lock:
            for sheet in self._sent:
                if len(sheet) == size and sheet.is_unused():
                    self._sent.remove(sheet)
                    break
            else:
                sheet = _new_sheet(size)
        return np.ndarray(shape, dtype, sheet)

    def pack(self, observation: Observation, shape: EstimateShape) -> PackedObservation:
        """Prepare an observation, and the shape that its estimate must have. Raises OSError."""
        plain: dict[str, Any] = {}
        arrays: dict[str, tuple[str, tuple[int, ...]]] = {}
        sheets: list[_Sheet] = []
        for field in dataclasses.fields(observation):
            value: Any = getattr(observation, field.name)
            if not isinstance(value, np.ndarray) or value.nbytes < _SMALL:
                plain[field.name] = value
                continue
            array: NDArray[Any] = value
            if not isinstance(array.base, _Sheet):
                array = self.allocate(value.shape, value.dtype)
                array[...] = value
            sheets.append(cast("_Sheet", array.base))
            arrays[field.name] = array.dtype.str, array.shape
        head = bytes(reduction.ForkingPickler.dumps((plain, arrays, shape)))
        first = _new_sheet(len(head))
        first[:] = head
        return PackedObservation((first, *sheets))

    def send(self, connection: Connection, packed: PackedObservation) -> None:
        """Send a packed observation. Raises OSError when the connection has ended."""
        connection.send_bytes(bytes([len(packed.sheets)]))
        for sheet in packed.sheets:
            handle = os.open(f"/proc/self/fd/{sheet.file}", os.O_RDONLY | os.O_CLOEXEC)
            try:
                reduction.send_handle(connection, handle, 0)
            finally:
                os.close(handle)
        with self._lock:
            self._sent.extend(packed.sheets[1:])


def receive_observation(connection: Connection) -> tuple[Observation, EstimateShape]:
    """Read what `Sender.send` sends. Raises EOFError when the connection has ended."""
    first, *sheets = [_receive_sheet(connection) for _ in range(connection.recv_bytes(1)[0])]
    plain, arrays, shape = reduction.ForkingPickler.loads(first)  # pyright: ignore
    for (name, (dtype, size)), content in zip(arrays.items(), sheets, strict=True):
        plain[name] = np.ndarray(size, dtype, content)
    return Observation(**plain), shape


def _receive_sheet(connection: Connection) -> mmap.mmap:
    with os.fdopen(reduction.recv_handle(connection), "rb") as file:
        sheet = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    with suppress(OSError):  # before Linux 5.14
        sheet.madvise(_POPULATE_READ)  # all pages at once cost half as much
    return sheet


def _new_sheet(size: int) -> _Sheet:
    sealed = hasattr(os, "memfd_create")
    if sealed:
        made = os.memfd_create("observation", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:  # a lease does not count the opening by memfd_create
            file = os.open(f"/proc/self/fd/{made}", os.O_RDWR | os.O_CLOEXEC)
        finally:
            os.close(made)
    else:
        with tempfile.TemporaryFile() as temporary:
            file = os.dup(temporary.fileno())
    try:
        os.posix_fallocate(file, 0, size)
        sheet = _Sheet(file, size)
    except (OSError, OverflowError):
        os.close(file)
        raise
    sheet.file, sheet.sealed = file, sealed
    if sealed:
        fcntl.fcntl(file, fcntl.F_ADD_SEALS, _SEAL_FUTURE_WRITE | fcntl.F_SEAL_SHRINK
                    | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
    return sheet
