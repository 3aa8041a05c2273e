"""A folder of sequences, read lazily."""

from __future__ import annotations

import operator
import re
import reprlib
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, DatasetError
from ..runtime import address, command_line, is_remote, list_folder, plural
from ..scene import RenderConfig, parse_config
from ..types import Sequence, html_card
from .provenance import DATASET_FILE, Provenance, read_provenance, sequence_counts
from .storage import SEQUENCES_FOLDER, open_sequence, read_meta

_THUMBNAILS = 4
"""Pictures on the card of a notebook."""
_READERS = 8
"""Sequences that are read at a time."""
_NAME = re.compile(r"(\d{6,})(\.zip)?")


@dataclass(frozen=True)
class Dataset:
    """A folder of sequences, those that existed when it was opened, in order.

    `dataset[0]` opens the first sequence and `dataset["000007"]` the one with that name, if
    `"000007" in dataset`; images are decoded when they are indexed. No file stays open: processes
    may share a pickled dataset.
    """

    path: Path
    config: RenderConfig
    """Configuration that rendered the dataset."""
    info: Provenance
    """`dataset.json`: generator, versions, assets and licences, counts."""
    names: tuple[str, ...]
    allow_model: bool = False
    """Whether its model may be read from a path in `config`, or downloaded."""

    def __repr__(self) -> str:
        c, n = self.config, len(self)
        return (f"Dataset({address(self.path)!r}, robot {reprlib.repr(c.robot)}, "
                f"{plural(n, 'sequence')} of {c.frames} frames, {c.width}x{c.height} px, "
                f"{c.randomization.motion.fps:g} fps, seed {c.seed})")

    def _repr_html_(self) -> str:
        c = self.config
        facts = {
            "robot": c.robot,
            "sequences": len(self),
            "videos": f"{c.frames} frames of {c.width} x {c.height} px, "
                      f"{c.randomization.motion.fps:g} per second",
            "seed": c.seed,
            "licence": ", ".join({str(a.get("licence", "")): 0 for a in self.info.assets}),
        }
        pictures = {f"sequence {name}": partial(self._first_image, name)
                    for name in self.names[:_THUMBNAILS]}
        return html_card(f"Dataset {address(self.path)}", facts, pictures)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before use, one line each: that its run has not ended."""
        return () if self.info.counts else (
            f"{address(self.path)} is not finished (its run has not ended); run the same gcbench "
            "render command again",)

    def _first_image(self, name: str) -> NDArray[np.uint8]:
        return self[name].rgb[0]

    @cached_property
    def _names(self) -> frozenset[str]:
        return frozenset(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Sequence]:
        return (self[name] for name in self.names)

    def __contains__(self, name: object) -> bool:
        """Return whether there is a sequence with a name."""
        return name in self._names

    def __getitem__(self, key: SupportsIndex | str) -> Sequence:
        """Return the sequence at a position, or with a name.

        Raises:
            IndexError: if there is no such position.
            TypeError: if the key is neither a whole number nor a name.
            DatasetError: if there is no such name, or the file is damaged.
        """
        name = key if isinstance(key, str) else self.names[operator.index(key)]
        if name not in self:
            raise DatasetError(f"{address(self.path)} has no sequence {name!r}; "
                               f"there are {describe_names(self.names)}")
        path = self.path / SEQUENCES_FOLDER / f"{name}.zip"
        is_zip = is_remote(path) or path.exists()
        return open_sequence(path if is_zip else path.with_suffix(""))


def describe_names(names: tuple[str, ...]) -> str:
    """Return "000000 to 000002", with gaps "2 from 000005 to 000007"; "none" of no names."""
    if not names:
        return "none"
    whole = int(names[-1]) - int(names[0]) == len(names) - 1
    return f"{'' if whole else f'{len(names)} from '}{names[0]} to {names[-1]}"


def open_dataset(path: str | Path, allow_model: bool = False) -> Dataset:
    """Open the dataset in a folder. Its sequences are read when they are indexed.

    Args:
        path: Folder of the dataset, or its address in object storage, such as
            "s3://bucket/data", of which only what is needed is read.
        allow_model: Whether functions that need the model may read it from the path that the
            dataset names, or download it. Allow it only for datasets that you trust.

    Returns:
        The dataset, a sequence of `Sequence` with its configuration and provenance.

    Raises:
        DatasetError: if the folder is not a dataset, or its `dataset.json` is invalid.

    Example:
        >>> config = gb.RenderConfig("owi535", frames=2, width=64, height=48)
        >>> _ = gb.render_dataset(config, 1, "data/example", progress=False)
        >>> dataset = gb.open_dataset("data/example")
        >>> dataset
        Dataset('data/example', robot 'owi535', 1 sequence of 2 frames, 64x48 px, 30 fps, seed 0)
        >>> dataset[0].frame(1).rgb.shape
        (48, 64, 3)
    """
    folder = Path(path)
    info = read_provenance(folder)
    where = f"{address(folder / DATASET_FILE)}: config"
    config = parse_config(info.config, where, error=DatasetError)
    return Dataset(folder, config, info, tuple(sorted(sequence_paths(folder), key=int)),
                   allow_model)


def default_output(dataset: Path, ending: str) -> Path:
    """Return the name of a dataset with an ending: what a command writes to if it is not told.

    It is in the current folder, or beside the dataset if that is the current folder or above it.
    """
    if is_remote(dataset):
        return Path(f"{dataset.name}{ending}")
    whole = dataset.resolve()
    within = Path.cwd().is_relative_to(whole)
    name = whole.name if dataset.name == ".." else dataset.absolute().name
    return (whole.parent if within else Path()) / f"{name}{ending}"


def sequence_paths(dataset: Path) -> dict[str, Path]:
    """Return the path of each sequence by name; a ZIP file is preferred to a folder."""
    folder = dataset / SEQUENCES_FOLDER
    found: dict[str, Path] = {}
    for path in list_folder(folder):  # "000000" sorts before "000000.zip"
        if match := _NAME.fullmatch(path.name):
            if match[2] is None and not path.is_dir():
                continue
            found[match[1]] = path
    return found


def count_sequences(paths: Iterable[Path]) -> dict[str, Any]:
    """Return `Provenance.counts` of sequences; several are read at a time, for storage that answers
    late. Raises DatasetError if one cannot be read."""
    with ThreadPoolExecutor(_READERS) as pool:
        return sequence_counts(pool.map(read_meta, paths))


def select_sequences(dataset: Dataset, text: str) -> list[str]:
    """Return the names of the sequences that `text` means, such as "0-9,15"; "" means all.

    Raises ConfigError if there are none of a number or range, and DatasetError if there are none.
    """
    if not dataset.names:
        raise DatasetError(f"{address(dataset.path)} has no sequences yet")
    there = {int(name): name for name in dataset.names}
    if not text:
        return list(dataset.names)
    numbers: dict[int, None] = {}
    for wanted in command_line.parse_ranges(text):
        found = [k for k in there if k in wanted]
        if not found:
            item = "-".join(map(str, dict.fromkeys((wanted[0], wanted[-1]))))
            raise ConfigError(f"{address(dataset.path)} has no sequence {item}; there are "
                              f"{describe_names(dataset.names)}")
        numbers.update(dict.fromkeys(sorted(found)))
    return [there[k] for k in numbers]
