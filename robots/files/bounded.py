"""Reading of files that may be hostile: regular files only, of bounded size."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from ...errors import GcbenchError, ModelError

MAX_FILE_BYTES = 256 * 2**20
"""Largest file of a model."""
_HASHES: ContextVar[dict[Path, str] | None] = ContextVar("hashes", default=None)


def read_bounded(
    path: Path, limit: int = MAX_FILE_BYTES, error: type[GcbenchError] = ModelError
) -> bytes:
    """Return the bytes of a file; symbolic links are followed.

    Raises `error` if the file is missing, is no regular file (a FIFO or a device, which could
    block), is larger than `limit` bytes, or has more bytes than its size says.
    """
    name = str(path).replace("\n", r"\n")  # a message is one line
    try:
        with open(path, "rb", opener=_open_without_blocking) as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise error(f"{name}: is not a regular file")
            if found.st_size > limit:
                raise error(f"{name}: is larger than {limit} bytes, the largest file that is read")
            data = file.read(found.st_size + 1)  # `read` allocates that much at once
    except OSError as problem:
        raise error(f"{name}: cannot be read ({problem.strerror or problem})") from problem
    if len(data) > found.st_size:
        raise error(f"{name}: has more bytes than the file system says")
    hashes = _HASHES.get()
    if hashes is not None:
        hashes[path.resolve()] = hashlib.sha256(data).hexdigest()
    return data


@contextmanager
def hash_files() -> Generator[dict[Path, str]]:
    """Yield the SHA-256 of each file that `read_bounded` returns while the block runs."""
    hashes = dict[Path, str]()
    token = _HASHES.set(hashes)
    try:
        yield hashes
    finally:
        _HASHES.reset(token)


def _open_without_blocking(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)
