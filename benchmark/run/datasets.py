"""The data of a run: datasets on disk, or those of a suite, which are rendered if missing."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import count
from pathlib import Path

from ...errors import ConfigError, DatasetError
from ...renderer.cluster import RayWorkers
from ...renderer.dataset import (
    Dataset,
    open_dataset,
    read_meta,
    select_sequences,
    sequence_name,
    sequence_paths,
)
from ...renderer.runtime import command_line, require_local, say
from ...renderer.scene import config_tree, differences
from ...robots.files import FolderInUseError
from ..protocol import truth_digest
from .suite import Suite, builtin_datasets

SUITES = Path("data") / "suites"
"""Where suites are rendered."""


@dataclass(frozen=True)
class Selection:
    """The datasets of a suite to evaluate, and the sequences of each dataset: of those named, the
    first observable ones."""

    sequences: str = ""
    """Numbers, such as 0-9,15; empty: all."""
    limit: int = 0
    """Largest number of them; 0: all."""
    keep_unobservable: bool = False
    datasets: tuple[str, ...] = ()
    """Names of datasets of a suite; empty: all."""


ALL = Selection()


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
    folders: Sequence[str | Path], selection: Selection = ALL, allow_model: bool = False
) -> list[Data]:
    """Open datasets; two folders of one name get their seeds as a part of the name.

    A folder with a dataset of a built-in suite gets the name that it has there, so that its rows
    are compared with the published ones.

    Raises DatasetError if a folder is not a dataset, or two have the same name and seed, and
    ConfigError if one lacks a selected sequence, or datasets of a suite are selected.
    """
    if selection.datasets:
        raise ConfigError("--datasets chooses from a suite; with --data, name only the folders to "
                          "use")
    of_suites = {name: config_tree(entry.config) for name, entry in builtin_datasets().items()}
    out: list[Data] = []
    for folder in map(Path, folders):
        data = select(folder.resolve().name, folder, selection, allow_model)
        for warning in data.dataset.warnings:
            say(warning)
        tree = config_tree(data.dataset.config)
        named = [name for name, of_suite in of_suites.items() if of_suite == tree]
        out.append(replace(data, name=named[0]) if named else data)
    plain = [data.name for data in out]
    out = [replace(data, name=f"{data.name}-seed-{data.dataset.config.seed}")
           if plain.count(data.name) > 1 else data for data in out]  # fmt: skip
    names = [data.name for data in out]
    if twice := [name for name in names if names.count(name) > 1]:
        raise DatasetError(f"two datasets are called {twice[0]!r}; rename one of the folders")
    return out


def from_suite(
    suite: Suite, folder: str | Path = SUITES, selection: Selection = ALL, progress: bool = True,
    may_render: bool = True, workers: RayWorkers | None = None,
) -> list[Data]:
    """Open the datasets of a suite, in FOLDER/SUITE/NAME; missing sequences are rendered first.

    While another process renders one of them, the call waits.

    Raises DatasetError if a folder holds another dataset, or rendering fails, and ConfigError if
    the suite lacks a selected dataset, a dataset lacks a selected sequence, or a sequence is
    missing that may not be rendered.
    """
    from ...renderer.generate import render_dataset

    require_local(Path(folder), "--suites")
    out: list[Data] = []
    for entry in suite.choose(selection.datasets).datasets:
        name, path = f"{suite.title}/{entry.name}", Path(folder, suite.title, entry.name)
        ranges = [range(min(entry.n, selection.limit or entry.n))]
        if selection.sequences:
            ranges = command_line.parse_ranges(selection.sequences)
        if (last := max(r[-1] for r in ranges)) >= entry.n:
            raise ConfigError(f"{name} has no sequence {last}; there are 0 to {entry.n - 1}")
        wanted = [*dict.fromkeys(k for r in ranges for k in r)]
        missing = len({sequence_name(k) for k in wanted} - {*sequence_paths(path)})
        if missing and not may_render:
            raise ConfigError(f"{name}: {missing} of {len(wanted)} sequences are not rendered, and "
                              f"shards do not render; run gcbench eval --suite {suite.name} "
                              "--method hold-still once without --shard")
        if missing:
            print(f"{name}: {missing} of {len(wanted)} sequences to render", file=sys.stderr)
        if may_render:
            render = partial(render_dataset, entry.config, wanted, path, workers,
                             progress and missing > 0)
            _when_free(render, name)
        elif changed := differences(
                config_tree(open_dataset(path).config), config_tree(entry.config)):
            raise DatasetError(f"{path} is not the dataset of the suite ({changed[0]}); delete it")
        here = replace(selection, sequences=",".join(map(str, wanted)))
        out.append(select(name, path, here, allow_model=True))
    return out


def _when_free(render: Callable[[], object], name: str) -> None:
    """Render once no other process writes to the dataset; it may evaluate on the same suite."""
    for tries in count():
        with suppress(FolderInUseError):
            render()
            return
        if tries == 1:  # a complete dataset is in use for a moment only
            say(f"{name}: waits for another gcbench that renders it")
        time.sleep(1.0)


def select(
    name: str, folder: Path, selection: Selection = ALL, allow_model: bool = False
) -> Data:
    """Select the observable sequences with a scored joint.

    Raises DatasetError if there are none, and ConfigError if a selected sequence is missing.
    """
    dataset, paths = open_dataset(folder, allow_model), sequence_paths(folder)
    names, limit = select_sequences(dataset, selection.sequences), selection.limit
    seen: list[str] = []
    scored: list[str] = []
    for s in names:
        if limit and len(scored) == limit:
            break
        meta = read_meta(paths[s])
        if selection.keep_unobservable or meta.observability.get("observable") is not False:
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
