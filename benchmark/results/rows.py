"""Rows of the leaderboard, and their scores as one flat table, `scores.csv`."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import io
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import msgspec
import numpy as np

from ...errors import DatasetError
from ...renderer.types import Inputs, Knowledge
from ...robots.files import read_bounded, write_atomically

if TYPE_CHECKING:
    import pandas

INPUTS: tuple[Inputs, ...] = get_args(Inputs)
KNOWLEDGE: tuple[Knowledge, ...] = get_args(Knowledge)
LABEL = "one line of 1 to 200 printable characters without @"
"""What the name, the version and the training of a method must be."""
_MAX_SCORES = 2**30  # bytes of a score table
_LARGEST, _FARTHEST = 1e12, 1e20
"""Largest value of a metric, and of `axis_distance`, which a very short screw makes large."""

SequenceName = Annotated[str, msgspec.Meta(pattern=r"^[0-9]{6,18}\Z")]
"""Name of a sequence in its dataset, such as 000007."""


@dataclass(frozen=True)
class Result:
    """One number: a line of `scores.csv`. Text is empty, and `frame` is -1, if none applies."""

    method: str
    """Name of the row: NAME, or NAME@ORACLE+ORACLE."""
    version: str
    inputs: str
    """none, rgb, rgbd or rgbd-noise."""
    knowledge: str
    """none, free, axes, kinematics or model."""
    oracles: str
    """Parts of the truth that the method received, joined by "+"."""
    training: str
    dataset: str
    """Name of a folder, or SUITE/NAME."""
    robot: str
    sequence: SequenceName
    cluster: str
    """Unit of the bootstrap: the sequence, or the object's instance if there are several."""
    joint: str
    """Name; empty if the number is about the whole sequence."""
    joint_index: Annotated[int, msgspec.Meta(ge=0, le=10_000)]
    """1 .. J from the base outward, 0 for the whole sequence."""
    joint_type: str
    """revolute, continuous or prismatic."""
    frame: Annotated[int, msgspec.Meta(ge=-1, le=1_000_000)]
    """Frame of the metric `error`, which has one line for each frame."""
    metric: str
    """benchmark/protocol/metrics.py defines each name."""
    value: Annotated[float, msgspec.Meta(ge=0.0)]
    unit: Literal["deg", "m", "px", "s", "MiB", ""]
    """deg, m, px, s, MiB, or empty for a share."""
    sign: Literal["given", "screw", "best", ""]
    """How the sign of the joint was decided: given (by the knowledge), screw (by the returned
    axis) or best (the sign with the smaller error)."""
    status: Literal["ok", "raised", "timeout", "crashed", "invalid"]
    """ok, or what went wrong: raised, timeout, crashed, invalid."""


@dataclass(frozen=True)
class Attribution:
    """Who made a method, where it is described, and when, as it declares; all may be empty."""

    authors: Annotated[str, msgspec.Meta(pattern=r"^[^\x00-\x1f\x7f]{0,300}\Z")] = ""
    """One line of at most 300 characters."""
    link: Annotated[str, msgspec.Meta(pattern=r"^(https?://[!-~]{1,300})?\Z")] = ""
    """Address of a paper, code or page: http:// or https://."""
    date: Annotated[str, msgspec.Meta(pattern=r"^(\d{4}(-\d\d(-\d\d)?)?)?\Z")] = ""
    """YYYY, YYYY-MM or YYYY-MM-DD."""


COLUMNS = tuple(field.name for field in dataclasses.fields(Result))
_KEY = ("sequence", "joint", "metric", "frame")
"""Columns that no two lines of one table share."""
_ERROR = re.compile(".*_error|error|displacement")
_AGAIN = "delete the table, and run the same `gcbench eval` or `gcbench score` again"


@dataclass(frozen=True)
class Row:
    """What one line of the leaderboard evaluates; a line never mixes two rows."""

    method: str
    """Name without oracles."""
    version: str
    inputs: Inputs
    knowledge: Knowledge
    training: str
    oracles: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name with oracles."""
        return self.method + ("@" + "+".join(self.oracles) if self.oracles else "")

    @property
    def title(self) -> str:
        """Name for progress and messages."""
        return f"{self.name} ({self.inputs}, {self.knowledge})"

    @property
    def folder(self) -> str:
        """A folder name that is valid on every file system and unique for each row."""
        plain = re.sub(r"[^A-Za-z0-9@+.-]", "-", self.name).lstrip(".")[:80]
        if plain != self.name:
            plain += "-" + hashlib.sha256(self.name.encode()).hexdigest()[:8]
        return f"{plain}_{self.inputs}_{self.knowledge}"


def is_label(text: object) -> bool:
    """Return whether a text is a LABEL."""
    return isinstance(text, str) and 0 < len(text) <= 200 and text.isprintable() and "@" not in text


def write_scores(path: Path, results: Iterable[Result]) -> None:
    """Create or replace a table of scores."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for r in results:
        values = [getattr(r, name) for name in COLUMNS]
        writer.writerow([f"{v:.9g}" if isinstance(v, float) else v for v in values])
    write_atomically(path, text.getvalue().encode())


def to_table(columns: Mapping[str, Sequence[Any]]) -> pandas.DataFrame:
    """Return scores by column, each text once: a row takes about 50 bytes, a `Result` 1500."""
    import pandas

    kinds = {"joint_index": int, "frame": int, "value": float}
    return pandas.DataFrame({
        name: np.array(columns[name], kinds[name]) if name in kinds
        else pandas.Categorical(columns[name]) for name in COLUMNS
    })  # fmt: skip


def read_scores(
    path: Path, shared: Mapping[str, str] | None = None, sequences: Collection[str] | None = None
) -> pandas.DataFrame:
    """Read a table of scores.

    With `shared`, all lines have these texts in the columns of these names; with `sequences`, all
    are of one of these.

    Raises DatasetError that names the line that is invalid, or the score that is there twice.
    """
    data = io.BytesIO(read_bounded(path, _MAX_SCORES, DatasetError))
    lines = csv.reader(io.TextIOWrapper(data, "utf-8", "replace", newline=""), strict=True)
    columns: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    texts: dict[str, str] = {}
    try:
        if tuple(next(lines, [])) != COLUMNS:
            raise ValueError(f"the first line is not {','.join(COLUMNS)}")
        for cells in lines:
            if len(cells) != len(COLUMNS):
                raise ValueError(f"{len(cells)} cells instead of {len(COLUMNS)}")
            tree = dict(zip(COLUMNS, cells, strict=True))
            result = msgspec.convert(tree, Result, strict=False)
            _check(result, shared or {}, sequences)
            for kept, x in zip(columns.values(), vars(result).values(), strict=True):
                kept.append(texts.setdefault(x, x) if isinstance(x, str) else x)
    except (ValueError, csv.Error) as error:
        raise DatasetError(f"{path}: line {lines.line_num}: {error}") from error
    table = to_table(columns)
    twice = table[table.duplicated([*_KEY])]
    if len(twice):
        sequence, joint, metric, frame = (twice.iloc[0][name] for name in _KEY)
        what = metric + f" of joint {joint}" * bool(joint) + f" at frame {frame}" * int(frame >= 0)
        raise DatasetError(f"{path}: two lines have {what} in sequence {sequence}; {_AGAIN}")
    return table


def _check(
    result: Result, shared: Mapping[str, str], sequences: Collection[str] | None
) -> None:
    """Raise ValueError if a line of a table is not one that `write_scores` has written."""
    value, metric, kind = result.value, result.metric, result.joint_type
    if not math.isfinite(value) and metric != "sigma":
        raise ValueError(f"$.value: {value} is not a finite number")
    largest = _FARTHEST if metric == "axis_distance" else _LARGEST
    if value > largest and metric != "sigma":
        raise ValueError(f"$.value: {value:g} is larger than {largest:g}")
    if _ERROR.fullmatch(metric) and result.unit not in ("deg", "m"):
        raise ValueError(f"$.unit: {metric} is in deg or m, got {result.unit!r}")
    if _ERROR.fullmatch(metric) and kind and (result.unit == "m") != (kind == "prismatic"):
        unit = "m" if kind == "prismatic" else "deg"
        raise ValueError(f"$.unit: {metric} of a {kind} joint is in {unit}, got {result.unit!r}")
    for name, text in shared.items():
        if getattr(result, name) != text:
            raise ValueError(f"$.{name}: it is not {text!r} as in run.json; {_AGAIN}")
    if sequences is not None and result.sequence not in sequences:
        raise ValueError(f"$.sequence: {result.sequence} is not in run.json; {_AGAIN}")
