"""A lock that admits one writer to a folder."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from ...errors import ConfigError

LOCK = ".lock"


@contextmanager
def lock_folder(out: Path) -> Generator[None]:
    """Lock the folder `out` for this process while the block runs, or raise ConfigError."""
    with (out / LOCK).open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            raise ConfigError(f"another gcbench is writing to {out} (process "
                              f"{file.read(20).strip()}); wait for it, or stop it") from error
        except OSError as error:
            # On a file system without locks two runs would only do the same work twice.
            if error.errno not in (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK):
                raise
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield


def is_free(folder: Path) -> bool:
    """Whether the lock of a folder exists and no process holds it; False if nobody can tell."""
    try:
        with (folder / LOCK).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
    except OSError:
        return False
