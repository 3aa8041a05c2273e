"""Hand an observation to the process of a method: a file without a name that both have open.

The sender never waits for the receiver, which may be stopped. The arrays of the receiver are
copies on write.
"""

from __future__ import annotations

import dataclasses
import mmap
import os
import tempfile
from multiprocessing import reduction
from multiprocessing.connection import Connection
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Observation
from ..results import EstimateShape

_ALIGNED = 64  # bytes


@dataclasses.dataclass(frozen=True)
class PackedObservation:
    """An observation in a file without a name: its arrays, and from `head` on the rest."""

    file: IO[bytes]
    head: int


def pack_observation(observation: Observation, shape: EstimateShape) -> PackedObservation:
    """Write an observation, and the shape that its estimate must have. Raises OSError."""
    plain: dict[str, Any] = {}
    arrays: dict[str, tuple[str, tuple[int, ...], int]] = {}
    file = _open_nameless()
    for field in dataclasses.fields(observation):
        value = getattr(observation, field.name)
        if isinstance(value, np.ndarray):
            array: NDArray[Any] = np.ascontiguousarray(value)
            file.seek(-(-file.tell() // _ALIGNED) * _ALIGNED)
            arrays[field.name] = array.dtype.str, array.shape, file.tell()
            file.write(array.data if array.size else b"")
        else:
            plain[field.name] = value
    head = file.tell()
    file.write(bytes(reduction.ForkingPickler.dumps((plain, arrays, shape))))
    file.flush()
    return PackedObservation(file, head)


def send_observation(connection: Connection, packed: PackedObservation) -> None:
    """Send a packed observation, and close its file here."""
    with packed.file as file:
        connection.send_bytes(packed.head.to_bytes(8, "little"))
        reduction.send_handle(connection, file.fileno(), 0)


def receive_observation(connection: Connection) -> tuple[Observation, EstimateShape]:
    """Read what `send_observation` sends. Raises EOFError when the connection has ended."""
    head = int.from_bytes(connection.recv_bytes(8), "little")
    handle = reduction.recv_handle(connection)
    with os.fdopen(handle, "rb") as file:
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    plain, arrays, shape = reduction.ForkingPickler.loads(content[head:])  # pyright: ignore
    for name, (dtype, size, start) in arrays.items():
        plain[name] = np.frombuffer(content, dtype, int(np.prod(size)), start).reshape(size)
    return Observation(**plain), shape


def _open_nameless() -> IO[bytes]:
    if hasattr(os, "memfd_create"):
        return os.fdopen(os.memfd_create("observation"), "wb")
    return tempfile.TemporaryFile()
