"""Locks of folders: one writer, or several that share the work."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO, cast

from ...errors import ConfigError

LOCK = ".lock"


class FolderInUseError(ConfigError):
    """Another process has locked the folder."""


@contextmanager
def lock_folder(out: Path, shared: bool = False) -> Generator[Callable[[], bool]]:
    """Lock the folder `out` for this process while the block runs, or raise FolderInUseError.

    Shared locks exclude only those that are not. The block gets a function that makes the lock
    exclusive, and returns whether no other process has it; False if the system cannot tell.
    """
    with _open(out / LOCK, "a+") as file:
        try:
            fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            process = file.read(20).strip()
            raise FolderInUseError(f"another gcbench is writing to {out} (process {process}); "
                                   "wait for it, or stop it") from error
        except OSError as error:
            # On a file system without locks two runs would only do the same work twice.
            if error.errno not in (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK):
                raise
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield lambda: _is_alone(file)


@contextmanager
def lock_briefly(folder: Path) -> Generator[None]:
    """Wait until no other block of this function runs for a folder.

    Where the file system has no locks, the block runs at once.
    """
    there = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):
            fcntl.flock(there, fcntl.LOCK_EX)
        yield
    finally:
        os.close(there)


def is_free(folder: Path) -> bool:
    """Whether the lock of a folder exists and no process holds it; False if that is unknown."""
    try:
        with _open(folder / LOCK, "r") as file:
            return _is_alone(file)
    except (OSError, ConfigError):
        return False


def _is_alone(file: TextIO) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _open(path: Path, mode: str) -> TextIO:
    """Open a lock file; raise ConfigError if it is a link, which may lead anywhere, or no file."""
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise ConfigError(f"{path}: is not a regular file; delete it")
    return cast("TextIO", path.open(mode))
