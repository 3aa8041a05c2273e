"""Results folders: what was run, the stored estimates and the scores.

    results/ROW/DATASET/run.json                what the row and the data are, and on what it ran
    results/ROW/DATASET/estimates/000000.zip    one a sequence: status, time, arrays (estimates.py)
    results/ROW/DATASET/scores.csv              a line is a `Result`; derived from the estimates

ROW is NAME[@ORACLE+...]_INPUTS_KNOWLEDGE; DATASET is a folder's name, or SUITE/NAME. Files are
replaced atomically: the estimates that exist show where a run continues, and scoring never runs a
method again. The files are text or arrays without pickle, and are read as untrusted input.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec

from ...errors import DatasetError
from ...renderer.runtime import dump_json, plural, read_record
from ...renderer.types import html_card
from ...robots.files import create_atomically, write_atomically
from .rows import COLUMNS, Attribution, Result, Row, SequenceName, read_scores, to_table

if TYPE_CHECKING:
    import pandas

RUN, ESTIMATES, SCORES = "run.json", "estimates", "scores.csv"
_FORMAT = "gcbench-results/1"
_SHOWN = 5
"""Failures on the card of a notebook."""


@dataclass(frozen=True)
class Run:
    """`run.json`: one row on one dataset."""

    row: Row
    source: str
    """The method's identity with its options, "icp" or "gcpose?flow=raft" (module:attribute if it
    is not registered, and for all methods in earlier versions), or "predictions"."""
    dataset: str
    """Name of a folder, or SUITE/NAME."""
    data: str
    """Folder of the dataset, as given by the user."""
    config: Mapping[str, Any]
    """The dataset's RenderConfig."""
    assets: tuple[Mapping[str, Any], ...]
    """Models of the dataset with their sources and licences."""
    sequences: tuple[SequenceName, ...]
    """The sequences that are scored, in order."""
    left_out: Annotated[int, msgspec.Meta(ge=0)]
    """Number of sequences that are not observable or have no scored joint."""
    limits: Mapping[str, Any]
    """seconds_per_sequence, workers, threads (of one worker)."""
    environments: tuple[Mapping[str, Any], ...]
    """Versions and machine of each installation that ran a part, in order."""
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Tuned numbers of the method; empty if it has none, or in files of earlier versions."""
    digests: Mapping[str, str] = field(default_factory=dict[str, str])
    """Hash of the truth of each sequence, by name; empty in files of earlier versions."""
    attribution: Attribution = field(default_factory=Attribution)
    """Authors, link and date of the method; empty in files of earlier versions."""
    files: Mapping[str, str] = field(default_factory=dict[str, str])
    """Hash of each file that an option of the method names, by the option, such as weights; empty
    in files of earlier versions."""


@dataclass(frozen=True)
class RunFolder:
    """A run on disk."""

    path: Path
    run: Run
    others: tuple[RunFolder, ...] = ()
    """Folders with the same row on other sequences of the dataset, which are a part of the run."""

    def estimate_path(self, sequence: str) -> Path:
        """Return the path of the estimate of a sequence, which need not exist."""
        for other in self.others:
            if sequence in other.run.sequences:
                return other.estimate_path(sequence)
        return self.path / ESTIMATES / f"{sequence}.zip"

    def scores(self) -> pandas.DataFrame:
        """Read the scores by column. Raises DatasetError if they are missing or damaged, or are not
        those of the run."""
        run = read_run(self.path / RUN)  # as it is stored, without a label
        row = run.row
        shared = {
            "method": row.name, "version": row.version, "inputs": row.inputs,
            "knowledge": row.knowledge, "oracles": "+".join(row.oracles),
            "training": row.training, "dataset": run.dataset,
        }  # fmt: skip
        first = read_scores(self.path / SCORES, shared, {*run.sequences})
        if not self.others:
            return first
        tables = [first[~first["sequence"].isin(_names(self.others))]]
        for other in self.others:
            table = other.scores()
            tables.append(table[table["sequence"].isin(other.run.sequences)])
        return to_table({name: [x for table in tables for x in table[name]] for name in COLUMNS})

    def join(self, other: RunFolder, sequences: Sequence[str]) -> RunFolder:
        """Return the run with these sequences of another folder, in place of its own of the same
        names."""
        other = replace(other, run=replace(other.run, sequences=tuple(sequences)))
        one, two = self.run, other.run
        environments = [e for e in two.environments if e not in one.environments]
        run = replace(
            one, sequences=tuple(dict.fromkeys((*one.sequences, *two.sequences))),
            digests={**one.digests, **two.digests},
            environments=(*one.environments, *environments))
        return replace(self, run=run, others=(*self.others, other))

    def results(self) -> list[Result]:
        """Read the scores, one object for each. Raises DatasetError as `scores`."""
        return [Result(*cells) for cells in self.scores().itertuples(index=False)]


def _names(folders: Iterable[RunFolder]) -> set[str]:
    return {name for folder in folders for name in folder.run.sequences}


def run_folder(results: Path, row: Row, dataset: str) -> Path:
    """Return the folder of the run of a row on a dataset."""
    return results / row.folder / dataset


def find_runs(results: Path | Iterable[Path]) -> list[RunFolder]:
    """Find every run under the folder or folders, sorted by path; links to folders are followed.

    Raises:
        DatasetError: If a folder does not exist or a run in it is damaged.
    """
    found: list[RunFolder] = []
    for folder in [results] if isinstance(results, Path) else results:
        if not folder.is_dir():
            raise DatasetError(f"{folder}: no such folder; `gcbench eval` makes one")
        found += [RunFolder(path.parent, read_run(path)) for path in sorted(_find_files(folder))]
    return found


def _find_files(folder: Path) -> Iterator[Path]:
    """Yield the path of each `run.json` once; a link shows what is not there without it."""
    seen: set[Path] = set()
    starts = [folder]
    while starts:
        links: list[Path] = []
        for start in starts:
            for root, folders, files in os.walk(start):
                here = Path(root)
                if here.resolve() in seen:
                    folders.clear()
                    continue
                seen.add(here.resolve())
                links += [here / name for name in folders if (here / name).is_symlink()]
                if RUN in files:
                    yield here / RUN
        starts = links


def read_run(path: Path) -> Run:
    """Read a `run.json`. Raises DatasetError that names the invalid field."""
    return read_record(path, Run, _FORMAT, only_known=True)


def write_run(folder: Path, run: Run, create: bool = False) -> bool:
    """Create or replace the `run.json` of a folder; with `create`, return False if there is one."""
    folder.mkdir(parents=True, exist_ok=True)
    data = dump_json({"format": _FORMAT, **dataclasses.asdict(run)})
    if create:
        return create_atomically(folder / RUN, data)
    write_atomically(folder / RUN, data)
    return True


@dataclass(frozen=True)
class Results:
    """The scored runs of one or more methods on one or more datasets.

    Of an evaluation with a shard, the numbers are those of the shard.
    """

    runs: tuple[RunFolder, ...]
    """One for each row and dataset."""
    estimated: int = 0
    """Number of sequences that were estimated now, not by an earlier call."""
    usable: int = 0
    """Number of sequences whose estimate did not fail, now or earlier."""
    failures: tuple[str, ...] = ()
    """One line for each estimate that failed, now or earlier, and for each method that did not
    run to its end."""
    ended_early: tuple[str, ...] = ()
    """One line for each method that did not run to its end; they are among the failures."""
    unfinished: tuple[str, ...] = ()
    """One line for each run that is not scored, because other shards have not ended."""

    def __repr__(self) -> str:
        counts = {"row": len({run.run.row for run in self.runs}),
                  "dataset": len({run.run.dataset for run in self.runs}),
                  "sequence": sum(len(run.run.sequences) for run in self.runs),
                  "failure": len(self.failures)}
        said = (plural(n, name) for name, n in counts.items())
        more = f", {len(self.unfinished)} unfinished" if self.unfinished else ""
        return f"Results({', '.join(said)}{more})"

    def _repr_html_(self) -> str:
        try:
            table = self._table()
        except DatasetError as error:
            table = [(error,)]
        failures = {f"failure {k}": line for k, line in enumerate(self.failures[:_SHOWN], 1)}
        return html_card(repr(self), failures, table=table)

    def _table(self) -> list[tuple[object, ...]]:
        """Return the error at the last frame of each row and dataset, with a head."""
        rows: list[tuple[object, ...]] = [
            ("dataset", "method", "inputs", "knowledge", "sequences", "mean error", "median")]
        frame = self.frame
        final = frame.loc[frame["metric"] == "final_error", :]
        names = ["dataset", "method", "version", "inputs", "knowledge", "unit"]
        for key, group in final.groupby(names, sort=False):
            dataset, method, version, inputs, knowledge, unit = key
            values = group["value"]
            rows.append((dataset, f"{method} {version}", inputs, knowledge,
                         group["sequence"].nunique(), f"{values.mean():.3g} {unit}",
                         f"{values.median():.3g} {unit}"))
        return rows

    @cached_property
    def frame(self) -> pandas.DataFrame:
        """All scores: one number a line, with the fields of `Result` as columns."""
        import pandas

        tables = [folder.scores() for folder in self.runs]
        columns = {name: [x for table in tables for x in table[name]] for name in COLUMNS}
        return pandas.DataFrame(columns, columns=list(COLUMNS))
