"""Files and folders that are complete or absent, after a kill at any moment."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Container, Generator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from secrets import token_hex

from ...errors import ModelError
from .lock import is_free, lock_folder

_STALE = 24 * 3600.0
"""s: age of the scratch folder of a killed process."""
_LOCKED = 1.0
"""s: age at which a running process has locked its scratch folder."""
_TEMPORARY = re.compile(
    r"\.(?P<name>.+?)(\.(?P<host>[0-9a-f]{8})[0-9a-f]{8})?\.(?P<pid>\d+)\.tmp")


@contextmanager
def replace_atomically(path: Path) -> Generator[Path]:
    """Yield the path of a temporary file that replaces `path` when the block ends.

    A reader sees the old file or the new one, whole. If the block raises, the temporary file is
    deleted and the old file stays.
    """
    temporary = temporary_name(path)
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:  # also a full disk or an interrupt
        with suppress(OSError):
            temporary.unlink()
        raise


def write_atomically(path: Path, data: bytes) -> None:
    """Create or replace a file; a reader sees the old one or the new one, whole."""
    with replace_atomically(path) as temporary:
        temporary.write_bytes(data)


def create_atomically(path: Path, data: bytes) -> bool:
    """Create a file, whole; return False if it exists, also if another process was faster."""
    temporary = temporary_name(path)
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.link(temporary, path)  # unlike a rename, this replaces nothing
    except FileExistsError:
        return False
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS):
            raise
        temporary.replace(path)  # there are no hard links here
    finally:
        temporary.unlink(missing_ok=True)
    return True


def create_folder_atomically(target: Path, name: str, fill: Callable[[Path], None]) -> Path:
    """Return the folder `target`; if it does not exist, create it whole or not at all.

    `fill` writes the content, called `name` in messages, into an empty folder, whose parent is a
    scratch folder of this call. Another process may create the target at the same time.
    """
    if target.is_dir():
        return target
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _remove_old_scratch(target.parent)
        work = Path(tempfile.mkdtemp(prefix=f"{target.name}-", suffix=".part", dir=target.parent))
    except OSError as error:
        raise ModelError(f"cannot write to the cache {target.parent} ({error.strerror}); "
                           "set GCBENCH_CACHE to a folder that can be written") from error
    try:
        with lock_folder(work):
            (work / "files").mkdir()
            fill(work / "files")
            try:
                (work / "files").replace(target)
            except OSError:
                if not target.is_dir():  # else another process was faster; its files are the same
                    raise
    except OSError as error:
        raise ModelError(f"cannot write {name} into {target.parent}: {error}") from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return target


@contextmanager
def scratch_folder(parent: Path, prefix: str = "") -> Generator[Path]:
    """Yield an empty folder in `parent`, which is deleted when the block ends.

    Folders with the prefix of killed processes of this user are deleted first.
    """
    parent.mkdir(parents=True, exist_ok=True)
    for old in parent.glob(f"{prefix}*"):
        with suppress(OSError):  # its owner has just finished
            if (not old.is_symlink() and old.stat().st_uid == os.getuid()
                    and _age(old) > _LOCKED and is_free(old)):
                shutil.rmtree(old, ignore_errors=True)
    work = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    try:
        with lock_folder(work):
            yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _age(path: Path) -> float:
    """Return the time, s, since a file or folder was changed."""
    return time.time() - path.stat().st_mtime


def _remove_old_scratch(folder: Path) -> None:
    """Delete scratch folders of killed processes: by their locks; by age where there are none."""
    for part in folder.glob("*.part"):
        with suppress(FileNotFoundError):  # its owner has just finished
            age = _age(part)
            if age > _STALE or (age > _LOCKED and is_free(part)):
                shutil.rmtree(part, ignore_errors=True)


def remove_leftovers(folder: Path, names: Container[str] | None = None) -> None:
    """Delete the temporary files in `folder` of processes that no longer run.

    With `names`, only those of the files of these names. Those of processes of another machine or
    container are deleted when they are old.
    """
    for path in folder.glob(".*.tmp"):
        match = _TEMPORARY.fullmatch(path.name)
        if match is None or not (names is None or match["name"] in names):
            continue
        with suppress(FileNotFoundError):  # its owner has just finished
            is_here = match["host"] in (None, _host())
            if not is_alive(int(match["pid"])) if is_here else _age(path) > _STALE:
                path.unlink()


def temporary_name(path: Path) -> Path:
    """Return a name in the same folder that tells its process; no reader takes its suffix."""
    return path.parent / f".{path.name}.{_host()}{token_hex(4)}.{os.getpid()}.tmp"


@cache
def _host() -> str:
    """Return 8 hexadecimal digits of this machine and container, where a process has one number."""
    space = ""
    with suppress(OSError):  # not on Linux
        space = str(Path("/proc/self/ns/pid").readlink())
    return hashlib.sha256(f"{socket.gethostname()} {space}".encode()).hexdigest()[:8]


def is_alive(pid: int) -> bool:
    """Return whether a process runs."""
    try:
        os.kill(pid, 0)
        # Without an init process in a container, ended processes stay as zombies.
        state = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2]
        return not state.strip().startswith(("Z", "X"))
    except ProcessLookupError:
        return False
    except OSError:  # another user's, or no /proc
        return True
