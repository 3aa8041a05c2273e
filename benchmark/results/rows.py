"""Results on disk: what was run, what was estimated, and the scores as one flat table.

    results/ROW/DATASET/run.json                what the row and the data are, and on what it ran
    results/ROW/DATASET/estimates/000000.zip    one a sequence: status, time, arrays (estimates.py)
    results/ROW/DATASET/scores.csv              a line is a `Result`; derived from the estimates

ROW is NAME[@ORACLE+...]_INPUTS_KNOWLEDGE; DATASET is a folder's name, or SUITE/NAME. A file is
written whole or not at all, so the estimates that are there say where a run continues, and scoring
never runs a method again. All of it is text, or arrays without pickle, and is read as untrusted.
"""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import io
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

from ...errors import GcbenchError
from ...renderer.runtime import MAX_JSON, dump_json, parse_json
from ...renderer.types import Inputs, Knowledge
from ...robots.files import write_atomically

if TYPE_CHECKING:
    import pandas

FORMAT = "gcbench-results/1"
RUN, ESTIMATES, SCORES = "run.json", "estimates", "scores.csv"
INPUTS: tuple[Inputs, ...] = get_args(Inputs)
KNOWLEDGE: tuple[Knowledge, ...] = get_args(Knowledge)
MAX_SCORES = 2**30
"""Bytes of a score table."""


@dataclass(frozen=True)
class Result:
    """One number: a line of `scores.csv`. Text is empty, and `frame` -1, where none applies."""

    method: str
    """Name of the row: NAME, or NAME@ORACLE+ORACLE."""
    version: str
    inputs: str
    """none, rgb, rgbd or rgbd-noise."""
    knowledge: str
    """none, free, axes, kinematics or model."""
    oracles: str
    """What it was given of the truth, joined by "+"."""
    training: str
    dataset: str
    """Name of a folder, or SUITE/NAME."""
    robot: str
    sequence: str
    """ "000007"; of one dataset."""
    cluster: str
    """What the bootstrap draws: the sequence, or the object's instance where there are several."""
    joint: str
    """Name; empty if the number is about the whole sequence."""
    joint_index: int
    """1 .. J from the base outward, 0 for the whole sequence."""
    joint_type: str
    """revolute, continuous or prismatic."""
    frame: int
    """Of the metric `error`, which has a line a frame."""
    metric: str
    """See metrics.py for each name's meaning."""
    value: float
    unit: str
    """deg, m, s, MiB, or empty for a share."""
    sign: str
    """How the sign of a joint was decided: given (by the knowledge), screw (by the returned axis)
    or best (the sign with the smaller error)."""
    status: str
    """ok, or what went wrong: raised, timeout, crashed, invalid."""


COLUMNS = tuple(field.name for field in dataclasses.fields(Result))
_INTEGERS = ("joint_index", "frame")


@dataclass(frozen=True)
class Row:
    """A line of the leaderboard, which never mixes two of them."""

    method: str
    """Without oracles."""
    version: str
    inputs: Inputs
    knowledge: Knowledge
    training: str
    oracles: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """With oracles."""
        return self.method + ("@" + "+".join(self.oracles) if self.oracles else "")

    @property
    def title(self) -> str:
        """For progress and messages."""
        return f"{self.name} ({self.inputs}, {self.knowledge})"

    @property
    def folder(self) -> str:
        """A name that any file system takes; different for different rows."""
        plain = re.sub(r"[^A-Za-z0-9@+.-]", "-", self.name).lstrip(".")[:80]
        if plain != self.name:
            plain += "-" + hashlib.sha256(self.name.encode()).hexdigest()[:8]
        return f"{plain}_{self.inputs}_{self.knowledge}"


@dataclass(frozen=True)
class Run:
    """`run.json`: one row on one dataset."""

    row: Row
    source: str
    """The method's identity with its options, "icp" or "gcpose?flow=raft" (module:attribute if it
    is not registered, and for all methods in earlier versions), or "predictions"."""
    dataset: str
    """As in `Result`."""
    data: str
    """Folder of the dataset, as it was given."""
    config: Mapping[str, Any]
    """The dataset's RenderConfig."""
    assets: tuple[Mapping[str, Any], ...]
    """Models of the dataset with sources and licences."""
    sequences: tuple[str, ...]
    """That are scored, in order."""
    left_out: int
    """Sequences of the dataset whose motion cannot be seen, or without a scored joint."""
    limits: Mapping[str, Any]
    """seconds_per_sequence, workers, threads (of one worker)."""
    environments: tuple[Mapping[str, Any], ...]
    """Versions and machine of each installation that ran a part, in order."""
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Tuned numbers of the method; empty if it has none, or in files of earlier versions."""


@dataclass(frozen=True)
class RunFolder:
    """A run that is on disk."""

    path: Path
    run: Run

    def estimate_path(self, sequence: str) -> Path:
        """Where the estimate of a sequence is, or will be."""
        return self.path / ESTIMATES / f"{sequence}.zip"

    def results(self) -> list[Result]:
        """The scores. Raises GcbenchError if they have not been written or are damaged."""
        return read_scores(self.path / SCORES)


def run_folder(results: Path, row: Row, dataset: str) -> Path:
    """Where the run of a row on a dataset belongs."""
    return results / row.folder / dataset


def find_runs(results: Path | Iterable[Path]) -> list[RunFolder]:
    """Every run under the folder or folders, sorted by path.

    Raises GcbenchError if a folder does not exist or a run in it is damaged.
    """
    found: list[RunFolder] = []
    for folder in [results] if isinstance(results, Path) else results:
        if not folder.is_dir():
            raise GcbenchError(f"{folder}: no such folder; `gcbench eval` makes one")
        found += [RunFolder(path.parent, read_run(path)) for path in sorted(folder.rglob(RUN))]
    return found


def table(results: Iterable[Result]) -> pandas.DataFrame:
    """The results as one data frame with a column for each field of `Result`."""
    import pandas

    rows = list(results)
    columns = {name: [getattr(row, name) for row in rows] for name in COLUMNS}
    return pandas.DataFrame(columns, columns=list(COLUMNS))


def write_scores(path: Path, results: Iterable[Result]) -> None:
    """Create or replace a table of scores."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for r in results:
        values = [getattr(r, name) for name in COLUMNS]
        writer.writerow([f"{v:.9g}" if isinstance(v, float) else v for v in values])
    write_atomically(path, text.getvalue().encode())


def read_scores(path: Path) -> list[Result]:
    """The table. Raises GcbenchError that names the line if it is not what we write."""
    text = _read(path, MAX_SCORES).decode(errors="replace")
    lines = csv.reader(io.StringIO(text, newline=""), strict=True)
    out: list[Result] = []
    try:
        if tuple(next(lines, [])) != COLUMNS:
            raise ValueError(f"the first line is not {','.join(COLUMNS)}")
        for cells in lines:
            if len(cells) != len(COLUMNS):
                raise ValueError(f"{len(cells)} cells instead of {len(COLUMNS)}")
            values: dict[str, Any] = dict(zip(COLUMNS, cells, strict=True))
            values |= {name: int(values[name]) for name in _INTEGERS}
            values["value"] = float(values["value"])
            out.append(Result(**values))
    except (ValueError, csv.Error) as error:
        raise GcbenchError(f"{path}: line {lines.line_num}: {error}") from error
    return out


def write_run(folder: Path, run: Run) -> None:
    """Create or replace `run.json`."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / RUN, dump_json({"format": FORMAT, **dataclasses.asdict(run)}))


def read_run(path: Path) -> Run:
    """A `run.json`. Raises GcbenchError that names the field that is not what it must be."""
    tree = parse_json(_read(path, MAX_JSON), str(path))
    if tree.pop("format", None) != FORMAT:
        raise GcbenchError(f"{path}: not of the format {FORMAT!r}")
    row = _strings(tree.pop("row", None), Row, path)
    oracles = _words(row.pop("oracles"), path, "oracles")
    if row["inputs"] not in INPUTS or row["knowledge"] not in KNOWLEDGE:
        raise GcbenchError(f"{path}: unknown inputs or knowledge")
    run = _strings({"settings": {}, **tree}, Run, path, without=("row",))
    for name, kind in (("config", dict), ("limits", dict), ("settings", dict), ("left_out", int)):
        if not isinstance(run[name], kind):
            raise GcbenchError(f"{path}: {name} is not what it must be")
    for name in ("assets", "environments"):
        if not isinstance(run[name], list) or not all(isinstance(x, dict) for x in run[name]):
            raise GcbenchError(f"{path}: {name} is not a list of objects")
        run[name] = tuple(run[name])
    run["sequences"] = _words(run["sequences"], path, "sequences")
    if not all(re.fullmatch(r"\d{6,}", name) for name in run["sequences"]):
        raise GcbenchError(f"{path}: sequences are not names of sequences")
    return Run(row=Row(oracles=oracles, **row), **run)


def _read(path: Path, limit: int) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except OSError as error:
        raise GcbenchError(f"{path}: {error.strerror}") from error
    if len(data) > limit:
        raise GcbenchError(f"{path}: larger than {limit} bytes")
    return data


def _strings(
    tree: Any, kind: type[Row] | type[Run], path: Path, without: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Fields of a dataclass from JSON; those annotated as text are text."""
    names = {f.name: f.type for f in dataclasses.fields(kind) if f.name not in without}
    if not isinstance(tree, dict) or set(cast("dict[str, Any]", tree)) != set(names):
        raise GcbenchError(f"{path}: expected the fields {', '.join(names)}")
    values = cast("dict[str, Any]", tree)
    for name, annotation in names.items():
        if annotation in ("str", "Inputs", "Knowledge") and not isinstance(values[name], str):
            raise GcbenchError(f"{path}: {name} is not text")
    return dict(values)


def _words(value: Any, path: Path, name: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(x, str) for x in cast("list[Any]", value)):
        raise GcbenchError(f"{path}: {name} is not a list of strings")
    return tuple(cast("list[str]", value))
