"""Score predictions of external methods, given as CSV or NPZ files.

The files are untrusted: parsing is strict and sizes are limited. Predictions are stored and scored
in the same way as estimates of methods that gcbench runs.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, DatasetError
from ...renderer.runtime import ArraySpec, parse_npz, require_local, say, to_record
from ...renderer.types import Estimate
from ...robots.files import read_bounded, write_atomically
from ...robots.geometry import Array
from ..methods import is_own
from ..protocol import are_compatible
from ..results import (
    LABEL,
    RUN,
    STATUSES,
    InvalidEstimateError,
    Results,
    Row,
    Run,
    RunFolder,
    Stored,
    check_start,
    dump_stored,
    is_label,
    read_run,
    run_folder,
)
from .datasets import SUITES, Selection, from_folders, from_suite
from .jobs import describe_run, name_unwritable, prepare_job, with_free_name
from .suite import read_suite
from .targets import Target, describe_degrees, describe_unscored, list_known, list_targets

PREDICTIONS_FORMAT = """\
expected a CSV
    # method: my-method
    # inputs: rgbd            (rgb, rgbd, rgbd-noise, none)
    # knowledge: free         (none, free, axes, kinematics, model)
    # training: none          (none, self-supervised, supervised: on what)
    # version: 1              (may be left out)
    sequence,frame,joint,displacement
    000000,1,1,0.0123
sequence: a name, or DATASET/NAME if there are several datasets; frame: 1 .. T-1 (frame 0 is 0);
joint: its name, or 1 .. J from the base outward; displacement: since frame 0, rad or m, nan where
unknown.
`gcbench score --template --predictions FILE` writes such a CSV with every target.
Or an NPZ (numpy.savez): texts method, inputs, knowledge, training, and an array [T J] for each
sequence by its name; NAME.screw [J 6] beside it may hold axes"""
MAX_BYTES = 2**28
_COLUMNS = ["sequence", "frame", "joint", "displacement"]
_KEYS = ("method", "inputs", "knowledge", "training", "version")
SOURCE = "predictions"
"""Identity of a method that ran elsewhere."""
_LISTED = 20  # missing targets in a message
_MAX_HEADER = 50  # lines
_MAX_TEXT = 200  # characters


@dataclass(frozen=True)
class Predictions:
    """The content of a predictions file."""

    row: Row
    displacement: dict[str, Array]
    """[T J], rad or m, for every key of `targets`."""
    screw: dict[str, Array]
    """[J 6] in the camera frame at frame 0, for the sequences that have one."""


@dataclass(frozen=True)
class ScoreConfig:
    """Score the predictions of a method that ran elsewhere: a CSV or an NPZ file.

    Examples:
      gcbench score --template --predictions new.csv --data data/ur5
      gcbench score --predictions new.csv --data data/ur5
      gcbench score --predictions new.csv --suite standard --datasets oven --sequences 0-9
    """

    predictions: Path
    """File of predictions, CSV or NPZ."""
    template: bool = False
    """Write a CSV with every target into the file of --predictions, to be filled in."""
    suite: str = "mini"
    """Name or TOML file of the predicted suite. Missing sequences are rendered first."""
    datasets: tuple[str, ...] = ()
    """Datasets of the suite to score, such as oven. Default: all."""
    data: tuple[Path, ...] = ()
    """Dataset folders to use instead of a suite."""
    sequences: str = ""
    """Numbers of the predicted sequences of each dataset, such as 0-9,15. Default: all."""
    limit: int = 0
    """Largest number of sequences of each dataset. 0: all."""
    results: Path = Path("results")
    """Folder for estimates and scores."""
    keep_unobservable: bool = False
    """Also score sequences whose motion cannot be observed in the images."""
    suites: Path = SUITES
    """Folder for the rendered datasets of suites."""


def score(
    predictions: str | Path, data: str | Path | Sequence[str | Path] = (),
    results: str | Path = "results", suite: str = "mini",
) -> Results:
    """Score the predictions of an external method.

    Args:
        predictions: A CSV or an NPZ file. The error for an invalid file describes the formats.
        data: One or more folders of the predicted datasets.
        results: Folder for estimates and scores. Earlier predictions of the same row are replaced.
        suite: Name or TOML file of a suite, used without `data`; missing sequences are rendered.

    Returns:
        One run per dataset; `frame` has all scores as a pandas DataFrame.

    Raises:
        DatasetError: If the file is invalid or a prediction is missing, or a dataset cannot be
            read.

    Example:
        >>> import gcbench as gb
        >>> results = gb.score("mine.csv", "data/ur5")
        >>> results.runs[0].run.row.method
        'mine'
    """
    folders = [data] if isinstance(data, str | Path) else data
    return score_predictions(ScoreConfig(
        Path(predictions), suite=suite, data=tuple(map(Path, folders)), results=Path(results)
    ))


def score_predictions(config: ScoreConfig, progress: bool = True) -> Results:
    """Score predictions; like `score`, with all options. A template has no runs."""
    file, results = config.predictions, config.results
    require_local(results, "--results")
    if file.exists() == config.template:
        raise DatasetError(f"{file}: {'exists' if config.template else 'no such file'}")
    if config.limit < 0:
        raise ConfigError("--limit must be 0 or more")
    selection = Selection(config.sequences, config.limit, config.keep_unobservable,
                          config.datasets)
    if config.data:
        data = from_folders(config.data, selection)
    else:
        data = from_suite(read_suite(config.suite), config.suites, selection, progress)
    wanted = list_targets(data)
    if config.template:
        with name_unwritable(file):
            write_atomically(file, template(wanted).encode())
        return Results(())
    found = read_predictions(file, wanted)
    if doubt := describe_degrees(found.displacement, wanted):
        say(f"{file}: {doubt}")
    folders: list[RunFolder] = []
    for d in data:
        run = with_free_name(describe_run(found.row, SOURCE, d, {}), results)
        check_source(run, results)
        job = prepare_job(run, d, results, retry=STATUSES)
        for key, target in wanted.items():
            if target.data is d:
                estimate = Estimate(found.displacement[key], found.screw.get(key))
                job.write(target.sequence, dump_stored(Stored("ok", estimate=estimate)))
        job.score()
        folders.append(job.folder)
    return Results(tuple(folders), len(wanted), len(wanted))


def check_source(run: Run, results: Path) -> None:
    """Raise DatasetError if `results` has this row from a method that gcbench ran."""
    path = run_folder(results, run.row, run.dataset) / RUN
    if path.exists() and read_run(path).source != run.source:
        raise DatasetError(
            f"{path.parent} holds estimates of {run.row.title} that gcbench eval made; declare "
            "another method name, or choose another --results folder"
        )


def template(wanted: Mapping[str, Target]) -> str:
    """Return a CSV of predictions with nan for every target."""
    text = io.StringIO()
    examples = ("my-method", "rgbd", "free", "none", "1")
    text.writelines(f"# {key}: {value}\n" for key, value in zip(_KEYS, examples, strict=True))
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for key, target in wanted.items():
        for t in range(1, target.frames):
            writer.writerows((key, t, name, "nan") for name in target.names)
    return text.getvalue()


def read_predictions(file: Path, wanted: Mapping[str, Target]) -> Predictions:
    """Read a predictions file. Raises DatasetError with the expected format."""
    data = read_bounded(file, MAX_BYTES, DatasetError)
    try:
        found = parse_arrays(data, wanted) if data[:2] == b"PK" else parse_csv(data, wanted)
    except (ValueError, csv.Error, DatasetError) as error:
        raise DatasetError(f"{file}: {error}; {PREDICTIONS_FORMAT}") from error
    for key, displacement in found.displacement.items():
        try:
            check_start(displacement[0])
        except InvalidEstimateError as error:
            raise DatasetError(f"{file}: sequence {key}: {error}") from error
    return found


def parse_csv(data: bytes, wanted: Mapping[str, Target]) -> Predictions:
    """Parse a CSV. Raises ValueError."""
    lines = io.StringIO(data.decode("utf-8-sig"), newline="")  # UnicodeDecodeError is a ValueError
    header: dict[str, str] = {}
    number, first = 0, ""
    for number, line in enumerate(lines, 1):
        first = line.strip()
        if first and not first.startswith("#"):
            break
        key, colon, value = first.lstrip("# ").partition(":")
        if colon:
            if key.strip() in header:
                raise ValueError(f"line {number}: {key.strip()} is there twice")
            header[key.strip()] = value.strip()
        if number > _MAX_HEADER:
            raise ValueError(f"no line {','.join(_COLUMNS)} in the first {_MAX_HEADER}")
    row = parse_header(header)
    if [cell.strip() for cell in first.split(",")] != _COLUMNS:
        raise ValueError(f"line {number}: {_short(first)} instead of {','.join(_COLUMNS)}")
    found = {key: np.zeros((t.frames, t.joints)) for key, t in wanted.items()}
    given = {key: np.zeros((t.frames, t.joints), bool) for key, t in wanted.items()}
    for at, cells in _rows(lines, number):
        if len(cells) != len(_COLUMNS):
            raise ValueError(f"line {at}: {len(cells)} cells instead of {len(_COLUMNS)}")
        key, frame, joint, value = (cell.strip() for cell in cells)
        if key not in wanted:
            if reason := describe_unscored(key, wanted):
                raise ValueError(f"line {at}: sequence {key}: {reason}")
            raise ValueError(f"line {at}: no sequence {_short(key)}; {list_known(wanted)}")
        target = wanted[key]
        t = _whole(frame, 0, target.frames - 1, f"line {at}: frame")
        if joint in target.names:
            j = target.names.index(joint)
        else:
            j = _whole(joint, 1, target.joints, f"line {at}: joint", target.names) - 1
        if given[key][t, j]:
            raise ValueError(f"line {at}: {key}, frame {t}, joint {j + 1} is there twice")
        given[key][t, j] = True
        found[key][t, j] = _real(value, f"line {at}: displacement")
    _require(given)
    return Predictions(row, found, {})


def parse_arrays(data: bytes, wanted: Mapping[str, Target]) -> Predictions:
    """Parse an NPZ. Raises ValueError."""
    specs = {key: ArraySpec((), "U", 4 * _MAX_TEXT) for key in _KEYS}
    for key, target in wanted.items():
        specs[key] = ArraySpec((target.frames, target.joints), "iuf")
        specs[f"{key}.screw"] = ArraySpec((target.joints, 6), "iuf")
    arrays = parse_npz(data, specs, "the NPZ", only_known=True)
    row = parse_header({key: str(arrays.pop(key)) for key in _KEYS if key in arrays})
    numbers = {name: array.astype(np.float64) for name, array in arrays.items()}
    found = {key: numbers[key] for key in wanted if key in numbers}
    screw = {key: numbers[f"{key}.screw"] for key in wanted if f"{key}.screw" in numbers}
    given = {key: np.full((t.frames, t.joints), key in found, bool) for key, t in wanted.items()}
    _require(given)
    return Predictions(row, found, screw)


def parse_header(header: Mapping[str, str]) -> Row:
    """Return the row that a header declares. Raises ValueError."""
    if missing := [key for key in _KEYS[:4] if not header.get(key)]:
        raise ValueError(f"the header does not say {', '.join(missing)}")
    if unknown := [key for key in header if key not in _KEYS]:
        raise ValueError(f"the header says {_short(unknown[0])}; there are {', '.join(_KEYS)}")
    for key, value in header.items():
        if not is_label(value):
            raise ValueError(f"{key} is {_short(value)}, expected {LABEL}")
    if is_own(name := header["method"].partition(" ")[0]):
        raise ValueError(f"method is {_short(header['method'])}; {name} is a method of gcbench: "
                         f"choose another name, such as my-{name}")
    row = to_record({"version": "1", **header}, Row, "the header")
    if not are_compatible(row.inputs, row.knowledge):
        raise ValueError(f"inputs {row.inputs} and knowledge {row.knowledge} do not go together")
    return row


def _rows(lines: io.StringIO, number: int) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(lines, strict=True)
    for cells in reader:
        if cells:
            yield number + reader.line_num, cells


def _require(given: Mapping[str, NDArray[np.bool_]]) -> None:
    """Raise ValueError with the missing targets; frame 0 is optional and zero by default."""
    missing: list[str] = []
    number = 0
    for key, there in given.items():
        lacking = ~there
        lacking[0] = False
        number += int(lacking.sum())
        if lacking[1:].all() and lacking[1:].size:
            missing.append(f"{key} (all)")
        else:
            missing += [f"{key} frame {t} joint {j + 1}" for t, j in np.argwhere(lacking)]
    if number:
        more = f" and {len(missing) - _LISTED} more" if len(missing) > _LISTED else ""
        raise ValueError(
            f"{number} targets are missing: {', '.join(missing[:_LISTED])}{more}; every one must "
            "be there, as nan where the method has no answer"
        )


def _whole(text: str, low: int, high: int, where: str, names: Sequence[str] = ()) -> int:
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII) or not low <= int(text) <= high:
        known = "".join(f", {_short(name)[1:-1]}" for name in names[:_LISTED])
        raise ValueError(f"{where} is {_short(text)}, expected {low} to {high}{known}")
    return int(text)


def _real(text: str, where: str) -> float:
    try:
        if len(text) > 64 or "_" in text:
            raise ValueError
        value = float(text)
    except ValueError:
        raise ValueError(f"{where} is {_short(text)}, expected a number") from None
    return value if math.isfinite(value) else math.nan


def _short(text: str) -> str:
    return ascii(text if len(text) <= 60 else text[:57] + "...")
