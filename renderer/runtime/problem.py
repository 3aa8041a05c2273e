"""Why a process gives up, as a record that it sends to the one that started it."""

from __future__ import annotations

import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from ...errors import GcbenchError, RenderError


@dataclass(frozen=True)
class Problem:
    """The process gives up."""

    text: str
    """One line for the user, or the traceback of a bug."""
    error: type[GcbenchError] | None
    """Kind of the error; None for a bug."""

    @classmethod
    def describe(cls, error: Exception, where: str = "", folder: Path | str = "") -> Problem:
        """Return the record of an error; `folder` is where an OSError without a file happened."""
        if isinstance(error, GcbenchError):
            return cls(f"{where}{error}", type(error))
        if isinstance(error, OSError):  # a full disk, no permission
            words = filter(None, (str(error.filename or folder), error.strerror or str(error)))
            return cls(where + ": ".join(words), RenderError)
        return cls(where + "".join(traceback.format_exception(error)), None)

    def throw(self, where: str = "") -> NoReturn:
        """Raise the error; RuntimeError for a bug."""
        raise (self.error or RuntimeError)(where + self.text)
