"""What every format does with the sequences of a dataset."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..dataset import Dataset
from ..runtime import Archive
from ..types import Sequence

SequenceRecord = Mapping[str, Any]
"""What a format must know later of a sequence that it has written, as JSON."""


class Writer:
    """Writes sequences of a dataset into a folder.

    Files of a sequence that an earlier run began may exist: they are written again.
    """

    def __init__(self, folder: Path, dataset: Dataset) -> None:
        self.folder, self.dataset = folder, dataset

    def add(self, sequence: Sequence, archive: Archive) -> SequenceRecord:
        """Write one more sequence, and return its record; `archive` holds its encoded images.

        Raises GcbenchError if the format cannot hold it.
        """
        raise NotImplementedError

    def keep(self, record: SequenceRecord) -> None:
        """Remember a sequence that `add` has written, now or in a run that was stopped."""

    def finish(self) -> None:
        """Write what is known only at the end."""

    def close(self) -> None:
        """Release what is open, after success or failure."""
