"""What worker processes of foreign code print, and the folder of their temporary files."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from ...robots.files import scratch_folder

_LAST, _LARGEST = 2000, 2**20  # bytes


@contextmanager
def output_folder() -> Generator[Path]:
    """Yield a folder for the processes of a pool; it is deleted at the end.

    Folders of pools that were killed are deleted first.
    """
    mine = Path(tempfile.gettempdir()) / f"gcbench-{os.getuid()}"
    mine.mkdir(mode=0o700, exist_ok=True)
    if mine.is_symlink() or mine.stat().st_uid != os.getuid():  # somebody else's
        with tempfile.TemporaryDirectory(prefix="gcbench-") as folder:
            yield Path(folder)
        return
    with scratch_folder(mine) as folder:
        yield folder


@dataclass(frozen=True)
class WorkerLog:
    """The file that a process prints to, which may be truncated at any time."""

    path: Path

    def end(self) -> str:
        """Return what was printed last; empty if nothing was, or the file is gone."""
        return self._end().decode(errors="replace").strip()

    def shorten(self) -> None:
        """Keep only the end of a file that has grown large."""
        with suppress(OSError):
            if self.path.stat().st_size > _LARGEST:
                end = self._end()
                self.clear()
                with self.path.open("ab") as file:
                    file.write(end)

    def clear(self) -> None:
        """Delete what was printed."""
        with suppress(OSError):
            os.truncate(self.path, 0)

    def redirect(self) -> None:
        """Send stdout and stderr of this process, of C libraries too, into the file."""
        import faulthandler

        file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        sys.stdout.flush()
        sys.stderr.flush()
        os.dup2(file, 1)
        os.dup2(file, 2)
        os.close(file)
        faulthandler.enable()  # prints where a segmentation fault happened

    def _end(self) -> bytes:
        with suppress(OSError), self.path.open("rb") as file:
            file.seek(max(0, self.path.stat().st_size - _LAST))
            return file.read(_LAST)
        return b""
