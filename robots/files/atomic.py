"""Files that are whole or not there, after a kill at any moment."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

_TEMPORARY = re.compile(r"\..+\.(?P<pid>\d+)\.tmp")


def write_atomically(path: Path, data: bytes) -> None:
    """Create or replace a file: a reader sees the old one or the new one, whole."""
    temporary = temporary_name(path)
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:  # a full disk, an interrupt: leave nothing behind
        with suppress(OSError):
            temporary.unlink()
        raise


def remove_leftovers(folder: Path) -> None:
    """Delete temporary files of processes that are gone; those of living ones stay."""
    for path in folder.glob(".*.tmp"):
        match = _TEMPORARY.fullmatch(path.name)
        if match and not is_alive(int(match["pid"])):
            path.unlink(missing_ok=True)


def temporary_name(path: Path) -> Path:
    """A name in the same folder that says whose it is and ends in nothing that is read."""
    return path.parent / f".{path.name}.{os.getpid()}.tmp"


def is_alive(pid: int) -> bool:
    """Whether a process is still at work."""
    try:
        os.kill(pid, 0)
        # In a container that nobody tidies, the dead stay in the table as zombies.
        state = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2]
        return not state.strip().startswith(("Z", "X"))
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's, or no /proc
        return True
