"""The data of a run: datasets on disk, or those of a suite, which are rendered if missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...errors import DatasetError
from ...renderer.dataset import Dataset, open_dataset, read_meta, sequence_paths
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

    def cluster(self, sequence: str) -> str:
        """Return the unit of the bootstrap: the object's instance if a dataset has several."""
        if "instance" not in self.dataset.config.vary:
            return sequence
        return str(self.dataset[sequence].meta.asset.get("instance", sequence))


def from_folders(folders: Sequence[Path], keep_unobservable: bool = False) -> list[Data]:
    """Open datasets. Raises DatasetError if a folder is not one, or two have the same name."""
    out = [select(folder.resolve().name, folder, None, keep_unobservable) for folder in folders]
    names = [data.name for data in out]
    if twice := [name for name in names if names.count(name) > 1]:
        raise DatasetError(f"two datasets are called {twice[0]!r}; rename one of the folders")
    return out


def from_suite(
    suite: Suite,
    folder: Path = SUITES,
    workers: int | None = None,
    keep_unobservable: bool = False,
    progress: bool = True,
    say: Callable[[str], None] = print,
) -> list[Data]:
    """Open the datasets of a suite, in FOLDER/SUITE/NAME; missing sequences are rendered first.

    Raises DatasetError if a folder holds another dataset, or rendering fails.
    """
    out: list[Data] = []
    for entry in suite.datasets:
        path = folder / suite.name / entry.name
        missing = entry.n - len([name for name in sequence_paths(path) if int(name) < entry.n])
        if missing:
            say(f"{suite.name}/{entry.name}: {missing} of {entry.n} sequences to render")
        from ...renderer.generate import render_dataset

        render_dataset(entry.config, entry.n, path, workers, progress=progress and missing > 0)
        out.append(select(f"{suite.name}/{entry.name}", path, entry.n, keep_unobservable))
    return out


def select(name: str, folder: Path, n: int | None, keep_unobservable: bool) -> Data:
    """Select the observable sequences with a scored joint among 0 .. n-1 (None: all).

    Raises DatasetError if there are none.
    """
    dataset, paths = open_dataset(folder), sequence_paths(folder)
    chosen = [s for s in dataset.names if n is None or int(s) < n]
    kept = chosen
    if not keep_unobservable:
        seen = {s: read_meta(paths[s]).observability.get("observable") for s in chosen}
        kept = [s for s in chosen if seen[s] is not False]
    scored = [s for s in kept if read_meta(paths[s]).scored_joints]
    if kept and not scored:
        raise DatasetError(
            f"{folder}: nothing to score, no sequence has a scored joint (an animation moves the "
            "model, or it has no joints); render with --animation none to move joints")
    kept = scored
    if not kept:
        raise DatasetError(f"{folder}: no observable sequence with a scored joint")
    return Data(name, dataset, tuple(kept), len(chosen) - len(kept))
