"""One writer at a time in a folder."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from ...errors import GcbenchError

LOCK = ".lock"


@contextmanager
def lock_folder(out: Path) -> Generator[None]:
    """Holds the folder for this process. Raises GcbenchError if another one holds it."""
    with (out / LOCK).open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            raise GcbenchError(
                f"another gcbench is writing to {out} (process {file.read(20).strip()})"
            ) from error
        except OSError as error:
            # A file system without locks: two runs would only do the same work twice.
            if error.errno not in (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK):
                raise
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield
