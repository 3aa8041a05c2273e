"""What worker processes of foreign code print."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

_LAST, _LARGEST = 2000, 2**20  # bytes


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
