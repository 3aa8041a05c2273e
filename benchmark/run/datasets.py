"""The data of a run: datasets on disk, or those of a suite, which are rendered if missing."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from ...errors import DatasetError
from ...renderer.dataset import Dataset, open_dataset, read_meta, sequence_paths
from ..protocol import truth_digest
from .suite import Suite

SUITES = Path("data") / "suites"
"""Where suites are rendered."""


@dataclass(frozen=True)
class Data:
    """One dataset to evaluate on."""

    name: str
    """Name of the folder, or SUITE/NAME."""
    dataset: Dataset
    sequences: tuple[str, ...]
    """Sequences to evaluate, in order: those that are observable."""
    left_out: int
    """Number of the others."""

    @cached_property
    def digests(self) -> dict[str, str]:
        """Hash of the truth of each sequence."""
        return {name: truth_digest(self.dataset[name]) for name in self.sequences}

    def cluster(self, sequence: str) -> str:
        """Return the unit of the bootstrap: the object's instance if a dataset has several."""
        if "instance" not in self.dataset.config.vary:
            return sequence
        return str(self.dataset[sequence].meta.asset.get("instance", sequence))


def from_folders(
    folders: Sequence[Path], keep_unobservable: bool = False, limit: int = 0,
    allow_model: bool = False,
) -> list[Data]:
    """Open datasets; two folders of one name get their seeds as a part of the name.

    Raises DatasetError if a folder is not a dataset, or two have the same name and seed.
    """
    out = [select(folder.resolve().name, folder, None, keep_unobservable, limit, allow_model)
           for folder in folders]  # fmt: skip
    plain = [data.name for data in out]
    out = [replace(data, name=f"{data.name}-seed-{data.dataset.config.seed}")
           if plain.count(data.name) > 1 else data for data in out]  # fmt: skip
    names = [data.name for data in out]
    if twice := [name for name in names if names.count(name) > 1]:
        raise DatasetError(f"two datasets are called {twice[0]!r}; rename one of the folders")
    return out


def from_suite(
    suite: Suite, folder: Path = SUITES, keep_unobservable: bool = False, limit: int = 0,
    progress: bool = True,
) -> list[Data]:
    """Open the datasets of a suite, in FOLDER/SUITE/NAME; missing sequences are rendered first.

    Raises DatasetError if a folder holds another dataset, or rendering fails.
    """
    from ...renderer.generate import render_dataset

    out: list[Data] = []
    for entry in suite.datasets:
        n = min(entry.n, limit or entry.n)
        path = folder / suite.title / entry.name
        missing = n - len([name for name in sequence_paths(path) if int(name) < n])
        if missing:
            print(f"{suite.title}/{entry.name}: {missing} of {n} sequences to render",
                  file=sys.stderr)  # fmt: skip
        render_dataset(entry.config, n, path, progress=progress and missing > 0)
        name = f"{suite.title}/{entry.name}"
        out.append(select(name, path, n, keep_unobservable, limit, allow_model=True))
    return out


def select(
    name: str, folder: Path, n: int | None, keep_unobservable: bool, limit: int = 0,
    allow_model: bool = False,
) -> Data:
    """Select the observable sequences with a scored joint among 0 .. n-1 (None: all), of these the
    first `limit` (0: all).

    Raises DatasetError if there are none.
    """
    dataset, paths = open_dataset(folder, allow_model), sequence_paths(folder)
    names = [s for s in dataset.names if n is None or int(s) < n]
    seen: list[str] = []
    scored: list[str] = []
    for s in names:
        if limit and len(scored) == limit:
            break
        meta = read_meta(paths[s])
        if keep_unobservable or meta.observability.get("observable") is not False:
            seen.append(s)
            scored += [s] if meta.scored_joints else []
    if seen and not scored:
        raise DatasetError(
            f"{folder}: nothing to score, no sequence has a scored joint (an animation moves the "
            "model, or it has no joints); render with --animation none to move joints")
    if not scored:
        raise DatasetError(f"{folder}: no observable sequence with a scored joint")
    left_out = 0 if limit else len(names) - len(scored)
    return Data(name, dataset, tuple(scored), left_out)
