"""Published rows: estimates of methods on the sequences of suites, and their scores.

    published/ROW/SUITE/DATASET.zip      estimates and scores of one row on one dataset
    published/truth/SUITE/DATASET.zip    what they are scored against: motion and axes, no images

A file is a ZIP of a JSON record and arrays without pickle, in single precision. The scores are
those of the stored numbers, so that anyone can compute them again without an image. Sequences of a
dataset have equal frames and joints.
"""

from __future__ import annotations

import dataclasses
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...renderer.runtime import (
    ArchiveWriter,
    ArraySpec,
    dump_json,
    open_archive,
    parse_json,
    parse_npz,
    to_record,
)
from ...renderer.types import Estimate
from ...robots.files import write_atomically
from ..protocol import Truth, has_axis, is_covered, score_motion
from ..results import Result, Row, Run, RunFolder, Status, Stored, to_table
from .lines import CONDITIONS, Line, Score, lines_of, name_count
from .statistics import SequenceJoint

PUBLISHED_ROWS = Path(__file__).parents[1] / "published"
"""Folder of the rows that come with this package."""
TRUTH = "truth"
_JSON, _ARRAYS = "record.json", "arrays.npz"
_FORMAT, _TRUTH_FORMAT = "gcbench-published/1", "gcbench-published-truth/1"
_MAX_BYTES = 2**27  # of the arrays of a file
_MAX_NUMBERS = 2**24  # of an array
_Name = Annotated[str, msgspec.Meta(pattern=r"^[0-9]{6,}\Z")]
_Names = Annotated[tuple[_Name, ...], msgspec.Meta(min_length=1, max_length=100_000)]


@dataclass(frozen=True)
class PublishedTruth:
    """The truth of S sequences of a dataset with T frames and J scored joints."""

    config: Mapping[str, Any]
    """The dataset's RenderConfig."""
    assets: tuple[Mapping[str, Any], ...]
    """Models with their sources and licences."""
    joint_names: Annotated[tuple[str, ...], msgspec.Meta(min_length=1, max_length=64)]
    joint_types: tuple[str, ...]
    frames: Annotated[int, msgspec.Meta(ge=2, le=10_000)]
    sequences: _Names
    """[S]"""
    attempts: tuple[Annotated[int, msgspec.Meta(ge=0, le=1000)], ...]
    """[S] draws that were refused before the one that the sequence shows."""
    clusters: tuple[str, ...]
    """[S] units of the bootstrap: the sequence or the object's instance."""
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict[str, NDArray[Any]])
    """displacement [S T J], screw [S J 6], origin [S J 3] and pixels [S J], as in `Truth`."""

    def of(self, sequence: str) -> Truth:
        """Return the truth of a sequence, without the labels of its parts."""
        k = self.sequences.index(sequence)
        doubles = {name: self.arrays[name][k].astype(np.float64)
                   for name in ("displacement", "screw", "origin")}
        return Truth(
            self.joint_names, self.joint_types, np.array(self.joint_types) == "prismatic",
            **doubles, label=np.zeros(0, np.uint8), parent=(), pixels=self.arrays["pixels"][k],
        )


@dataclass(frozen=True)
class PublishedRow:
    """A row on one dataset."""

    run: Run
    """Without config, models and digests, which are those of the truth, and without settings, which
    are those of the method's version."""
    date: Annotated[str, msgspec.Meta(pattern=r"^\d{4}-\d\d-\d\d\Z")]
    """Of the last measurement."""
    command: Annotated[str, msgspec.Meta(max_length=2000)]
    """Command that repeats the row."""
    status: tuple[Status, ...]
    """[S] of each sequence of the run."""
    scores: tuple[Score, ...] = ()
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict[str, NDArray[Any]])
    """displacement [S T J], screw [S J 6], sigma [S T J] in half precision, reliable [S J],
    seconds [S] and peak_memory [S], MiB; NaN, or -1 of `reliable`, where the method said nothing.
    And their score, the final error [S J], deg or m."""

    def unpack_estimates(self) -> list[Stored]:
        """Return the estimates in the order of the run's sequences."""
        a = self.arrays
        out: list[Stored] = []
        for k, status in enumerate(self.status):
            estimate = None
            if status == "ok":
                screw, sigma, reliable = a["screw"][k], a["sigma"][k], a["reliable"][k]
                estimate = Estimate(
                    a["displacement"][k].astype(np.float64),
                    None if np.isnan(screw).all() else screw.astype(np.float64), None,
                    None if np.isnan(sigma).all() else sigma.astype(np.float64),
                    None if (reliable < 0).all() else reliable > 0,
                )
            seconds, memory = (None if np.isnan(a[name][k]) else float(a[name][k])
                               for name in ("seconds", "peak_memory"))
            out.append(Stored(status, "", seconds, memory, estimate))
        return out


def truth_path(folder: Path, dataset: str) -> Path:
    """Return the file of the truth of a dataset SUITE/NAME."""
    return folder / TRUTH / f"{dataset}.zip"


def row_path(folder: Path, row: Row, dataset: str) -> Path:
    """Return the file of a row on a dataset SUITE/NAME."""
    return folder / row.folder / f"{dataset}.zip"


def pack_truth(truths: Sequence[Truth]) -> dict[str, NDArray[Any]]:
    """Return the arrays of sequences with equal frames and joints."""
    arrays = {name: np.stack([getattr(t, name) for t in truths]).astype(np.float32)
              for name in ("displacement", "screw", "origin")}
    return arrays | {"pixels": np.stack([t.pixels for t in truths]).astype(np.int32)}


def pack_estimates(stored: Sequence[Stored], frames: int, joints: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of estimates, see `PublishedRow.arrays`, without parts and scores."""
    nothing = Estimate(np.full((frames, joints), np.nan))
    found = [s.estimate or nothing for s in stored]

    def stack(name: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
        values = (getattr(e, name) for e in found)
        return np.stack([np.full(shape, np.nan) if v is None else v for v in values], dtype="f4",
                        casting="same_kind")

    with np.errstate(over="ignore"):  # a large standard deviation becomes infinite
        sigma = stack("sigma", (frames, joints)).astype(np.float16)
    return {
        "displacement": stack("displacement", (frames, joints)),
        "screw": stack("screw", (joints, 6)),
        "sigma": sigma,
        "reliable": np.stack([np.full(joints, -1) if e.reliable is None else e.reliable
                              for e in found]).astype(np.int8),
        **{name: np.array([np.nan if (value := getattr(s, name)) is None else value
                           for s in stored], np.float32)
           for name in ("seconds", "peak_memory")},
    }  # fmt: skip


def score_published(row: PublishedRow, truth: PublishedTruth) -> PublishedRow:
    """Return the row with the scores of its estimates against the truth."""
    run = replace(row.run, config=truth.config)
    cluster = dict(zip(truth.sequences, truth.clusters, strict=True))
    results: list[Result] = []
    for name, stored in zip(run.sequences, row.unpack_estimates(), strict=True):
        results += score_motion(truth.of(name), stored, run, name, cluster[name])
    scores: list[Score] = []
    error = np.zeros((len(run.sequences), len(truth.joint_names)), np.float32)
    columns = {f.name: [getattr(r, f.name) for r in results] for f in dataclasses.fields(Result)}
    for line in lines_of(RunFolder(Path(), run), to_table(columns)):
        for (sequence, joint), value in line.error.items():
            error[run.sequences.index(sequence), truth.joint_names.index(joint)] = value
        kept: dict[str, Any] = {f.name: getattr(line, f.name) for f in dataclasses.fields(Score)}
        scores.append(Score(**kept))
    return replace(row, scores=tuple(scores), arrays={**row.arrays, "error": error})


def published_files(folder: Path) -> list[Path]:
    """Return the files of rows in a folder. Raises DatasetError if there are none."""
    files = [path for path in sorted(folder.glob("*/*/*.zip")) if path.parts[-3] != TRUTH]
    if not files:
        raise DatasetError(f"{folder}: no published rows; `gcbench publish` makes them")
    return files


def published_lines(
    folder: Path, sequences: Mapping[str, Sequence[frozenset[str]]] | None = None
) -> list[Line]:
    """Read the lines of all published rows of a folder.

    With `sequences` by the name of the dataset, only rows on these datasets are read. They are
    scored on the first of these sets of sequences that the most rows have, if they have it.

    Raises DatasetError if a file is damaged, or the folder holds no row.
    """
    truths: dict[str, PublishedTruth] = {}
    found: dict[str, list[tuple[Path, PublishedRow]]] = {}
    for path in published_files(folder):
        dataset = f"{path.parts[-2]}/{path.stem}"
        if not sequences or dataset in sequences:
            found.setdefault(dataset, []).append((path, read_row(path, folder, truths)))
    rows: dict[str, list[tuple[Path, PublishedRow]]] = {}
    for dataset, there in found.items():
        names = [{*row.run.sequences} for _, row in there]
        chosen = max((sequences or {}).get(dataset, ()), default=frozenset[str](),
                     key=lambda some, names=names: sum(some <= mine for mine in names))
        for path, row in there:
            if chosen and chosen < {*row.run.sequences}:
                row = score_published(_select(row, chosen), truths[dataset])
            rows.setdefault(path.parts[-3] + "/" + path.parts[-2], []).append((path, row))
    out: list[Line] = []
    for mine in rows.values():
        n = name_count([len(row.run.sequences) for _, row in mine])
        for path, row in mine:
            out += _lines(row, path, truths[row.run.dataset], n)
    return out


def _select(row: PublishedRow, names: frozenset[str]) -> PublishedRow:
    """Return a row with some of its sequences alone, without scores."""
    kept = [k for k, name in enumerate(row.run.sequences) if name in names]
    arrays = {name: array[kept] for name, array in row.arrays.items() if name != "error"}
    return replace(
        row, run=replace(row.run, sequences=tuple(row.run.sequences[k] for k in kept)),
        status=tuple(row.status[k] for k in kept), scores=(), arrays=arrays)


def _lines(row: PublishedRow, path: Path, truth: PublishedTruth, n: str) -> Iterable[Line]:
    run = replace(row.run, config=truth.config, assets=truth.assets)
    cluster = dict(zip(truth.sequences, truth.clusters, strict=True))
    seen = [(k, name, truth.of(name)) for k, name in enumerate(run.sequences)]
    for score in row.scores:
        scale = 1.0 if score.unit == "m" else math.degrees(1.0)
        error: dict[SequenceJoint, float] = {}
        conditions: dict[str, dict[SequenceJoint, float]] = {name: {} for name in CONDITIONS}
        joints = [truth.joint_names.index(joint.name) for joint in score.joints]
        for (k, name, true), j in product(seen, joints):
            pair = name, truth.joint_names[j]
            error[pair] = float(row.arrays["error"][k, j])
            conditions["displacement"][pair] = scale * abs(float(true.displacement[-1, j]))
            conditions["pixels"][pair] = float(true.pixels[j])
            conditions["distance"][pair] = float(np.linalg.norm(true.origin[j]))
        yield Line(
            run=RunFolder(path, run), robot=Path(str(truth.config.get("robot", ""))).stem,
            error=error, cluster={pair: cluster[pair[0]] for pair in error}, conditions=conditions,
            answers=_count_answers(row, truth, joints),
            published=row.date, extent=n,
            **vars(score),
        )


def _count_answers(row: PublishedRow, truth: PublishedTruth, joints: list[int]) -> dict[str, int]:
    """Return `Line.answers` of some joints, without scoring the estimates again."""
    a, kinds = row.arrays, np.array(truth.joint_types)[joints]
    screws = a["screw"].astype(np.float64)
    given = np.array([status == "ok" for status in row.status])[:, None]
    covered = np.stack([is_covered(moved, len(truth.joint_names)) for moved in a["displacement"]])
    told = (a["reliable"] >= 0).any(1, keepdims=True)
    found = {
        "within_sigma": (covered & (a["sigma"][:, -1] >= 0))[:, joints],
        "reliable": np.broadcast_to(told, covered.shape)[:, joints],
        "axis_direction": np.stack([has_axis(s[:, :3]) for s in screws])[:, joints],
        "axis_distance": np.stack([has_axis(s) for s in screws])[:, joints]
        & (kinds != "prismatic"),
    }
    return {name: n for name, which in found.items() if (n := int((which & given).sum()))}


def read_row(path: Path, folder: Path, truths: dict[str, PublishedTruth]) -> PublishedRow:
    """Read a row and, unless `truths` has it by the name of the dataset, its truth.

    Raises DatasetError if a file is damaged, or the row has a sequence without truth.
    """
    tree, data = _read(path, _FORMAT)
    row = to_record(tree, PublishedRow, str(path))
    run = row.run
    if row_path(folder, run.row, run.dataset) != path:
        raise DatasetError(f"{path}: it holds {run.row.title} on {run.dataset}; rename the file")
    truth = truths.get(run.dataset) or read_truth(truth_path(folder, run.dataset))
    truths[run.dataset] = truth
    s, j = len(run.sequences), len(truth.joint_names)
    if unknown := {*run.sequences} - {*truth.sequences}:
        raise DatasetError(f"{path}: sequence {min(unknown)} is not in the truth")
    scored = {joint.name for score in row.scores for joint in score.joints}
    if len(row.status) != s or not scored <= {*truth.joint_names}:
        raise DatasetError(f"{path}: its lists do not fit its sequences and joints")
    moved = (s, truth.frames, j)
    specs = {"displacement": moved, "screw": (s, j, 6), "sigma": moved, "reliable": (s, j),
             "seconds": (s,), "peak_memory": (s,), "error": (s, j)}
    return replace(row, arrays=_parse(data, specs, path))


def read_truth(path: Path) -> PublishedTruth:
    """Read the truth of a dataset. Raises DatasetError if the file is damaged."""
    tree, data = _read(path, _TRUTH_FORMAT)
    truth = to_record(tree, PublishedTruth, str(path))
    s, j = len(truth.sequences), len(truth.joint_names)
    if {len(truth.attempts), len(truth.clusters)} != {s} or len(truth.joint_types) != j:
        raise DatasetError(f"{path}: its lists do not fit its sequences and joints")
    specs = {"displacement": (s, truth.frames, j), "screw": (s, j, 6), "origin": (s, j, 3),
             "pixels": (s, j)}
    return replace(truth, arrays=_parse(data, specs, path))


def write_record(path: Path, record: PublishedRow | PublishedTruth) -> None:
    """Create or replace the file of a row or a truth; equal contents are equal bytes."""
    kind = _TRUTH_FORMAT if isinstance(record, PublishedTruth) else _FORMAT
    out, data = io.BytesIO(), io.BytesIO()
    tree = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
    arrays = tree.pop("arrays")
    np.savez_compressed(data, **arrays)
    archive = ArchiveWriter(out)
    archive.add(_JSON, dump_json({"format": kind, **msgspec.to_builtins(tree)}))
    archive.add(_ARRAYS, data.getvalue())
    archive.close()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, out.getvalue())


def _read(path: Path, kind: str) -> tuple[dict[str, Any], bytes]:
    archive = open_archive(path)
    tree = parse_json(archive.read(_JSON, 2**25), archive.where(_JSON), kind)
    tree.pop("arrays", None)
    return tree, archive.read(_ARRAYS, _MAX_BYTES)


def _parse(
    data: bytes, shapes: Mapping[str, tuple[int, ...]], path: Path
) -> dict[str, NDArray[Any]]:
    if any(math.prod(shape) > _MAX_NUMBERS for shape in shapes.values()):
        raise DatasetError(f"{path}: more than {_MAX_NUMBERS} numbers in an array")
    specs = {name: ArraySpec(shape, item_bytes=4) for name, shape in shapes.items()}
    arrays = parse_npz(data, specs, f"{path}: {_ARRAYS}", only_known=True)
    if missing := specs.keys() - arrays.keys():
        raise DatasetError(f"{path}: {min(missing)} is missing")
    return arrays
