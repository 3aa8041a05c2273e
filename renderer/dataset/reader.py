"""A folder of sequences, read lazily."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ...errors import DatasetError, GcbenchError
from ..scene import RenderConfig, parse_config
from ..types import Sequence
from .provenance import FILE, Provenance, read_provenance
from .storage import FOLDER, open_sequence

__all__ = ["Dataset", "open_dataset", "open_sequence", "sequence_paths"]

_NAME = re.compile(r"(\d{6,})(\.zip)?")


@dataclass(frozen=True)
class Dataset:
    """The sequences that were there when it was opened, in order.

    `dataset[0]` opens the first, `dataset["000007"]` the one of that name; both decode images
    only when these are indexed. Nothing is held open: it may be pickled and shared by processes.
    """

    path: Path
    config: RenderConfig
    """What it was rendered with."""
    info: Provenance
    """`dataset.json`: generator, versions, assets and licences, counts."""
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Sequence]:
        return (self[name] for name in self.names)

    def __getitem__(self, key: int | str) -> Sequence:
        """The sequence at a position, or of a name.

        Raises IndexError, or GcbenchError if there is no such name or the file is damaged.
        """
        name = self.names[key] if isinstance(key, int) else key
        if name not in self.names:
            there = f"{self.names[0]} to {self.names[-1]}" if self.names else "none"
            raise GcbenchError(f"{self.path} has no sequence {name!r}; there are: {there}")
        path = self.path / FOLDER / f"{name}.zip"
        return open_sequence(path if path.exists() else path.with_suffix(""))


def open_dataset(path: str | Path) -> Dataset:
    """Open the dataset in a folder. Its sequences are read when they are asked for.

    Args:
        path: Folder of the dataset.

    Returns:
        The dataset: a sequence of `Sequence`, with its configuration and provenance.

    Raises:
        DatasetError: There is no dataset in the folder, or its `dataset.json` is invalid.

    Example:
        >>> dataset = gb.open_dataset("data/ur5")
        >>> dataset[0].frame(1).rgb.shape
        (48, 64, 3)
    """
    folder = Path(path)
    info = read_provenance(folder)
    config = parse_config(info.config, f"{folder / FILE}: config", error=DatasetError)
    return Dataset(folder, config, info, tuple(sorted(sequence_paths(folder), key=int)))


def sequence_paths(dataset: Path) -> dict[str, Path]:
    """ZIP file or folder of each sequence by name; a ZIP goes before a folder of the same name."""
    folder = dataset / FOLDER
    if not folder.is_dir():
        return {}
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):  # "000000" stands before "000000.zip"
        if match := _NAME.fullmatch(path.name):
            if match[2] is None and not path.is_dir():
                continue
            found[match[1]] = path
    return found
