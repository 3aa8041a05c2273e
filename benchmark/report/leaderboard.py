"""The leaderboard: one line for each row, dataset and unit, from the score tables alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, DatasetError
from ...renderer.scene import differences as config_differences
from ..protocol import PCP_DEGREES, pcp_thresholds
from ..results import SCORES, Row, RunFolder, find_runs, is_label
from . import published_numbers as paper
from .calibration import Calibration, calibrate
from .copies import dataset_title, have_equal_motions, without_copies
from .labels import label_rows
from .statistics import (
    MIN_CLUSTERS,
    SEED,
    Difference,
    ErrorSummary,
    SequenceJoint,
    compare_rows,
    pcp,
    shared_ranks,
    summarize,
)

if TYPE_CHECKING:
    import pandas

_CURVE = sorted({*PCP_DEGREES, *(float(f"{x:.3g}") for x in np.geomspace(0.02, 90, 110))})
CURVE_THRESHOLDS: Mapping[str, tuple[float, ...]] = {
    "deg": tuple(_CURVE),
    "m": tuple(float(f"{x / 100:.5g}") for x in _CURVE),
}
"""Thresholds of the PCP curves by unit: degrees, or for prismatic joints as many cm, in m."""
SECONDARY = ("mean_error", "step_error", "axis_direction", "axis_distance", "within_sigma",
             "reliable", "part_miou", "peak_memory", "seconds_per_frame")  # fmt: skip
"""Metrics that a line shows as a mean over the joints (or sequences) that have them."""
CONDITIONS = ("displacement", "pixels", "distance")
"""Metrics of the truth that errors are shown against; scores of earlier versions lack the last two.
"""


@dataclass(frozen=True)
class JointScore:
    """Final errors of one joint."""

    name: str
    index: int
    """1 .. J from the base outward."""
    summary: ErrorSummary


@dataclass(frozen=True)
class Score:
    """The score of one row on one dataset, in one unit: deg, or m for prismatic joints."""

    unit: str
    summary: ErrorSummary
    """Of the final errors."""
    joints: tuple[JointScore, ...]
    drift: tuple[float, ...]
    """[T] mean error at each frame."""
    curve: tuple[float, ...]
    """Percent of (sequence, joint) pairs within each of CURVE_THRESHOLDS."""
    means: Mapping[str, float]
    """Mean of each metric of SECONDARY that the scores contain."""
    calibration: Calibration | None
    """None if the method reports neither standard deviations nor flags."""
    sign: str
    """How the signs were decided (see `Result.sign`); several are joined by "+"."""
    failed: Mapping[str, str]
    """Status of each sequence that failed."""


@dataclass(frozen=True)
class Line(Score):
    """A score with its run and its errors."""

    run: RunFolder
    robot: str
    """Name without folders."""
    error: Mapping[SequenceJoint, float]
    """Final error of each (sequence, joint)."""
    cluster: Mapping[SequenceJoint, str]
    """What the bootstrap draws: the sequence or object instance of each (sequence, joint)."""
    conditions: Mapping[str, Mapping[SequenceJoint, float]]
    """Value of each of CONDITIONS of each (sequence, joint) that has one."""
    published: str = ""
    """Date of a published row, a reference beside the user's own; else empty."""
    extent: str = ""
    """Number of sequences of each dataset of a published row, as "n = 20"; of a row whose scores
    lack some, as "5 of 6 sequences"; else empty."""

    @property
    def sequences(self) -> frozenset[str]:
        """Names of the sequences that are scored."""
        return frozenset(sequence for sequence, _ in self.error)

    @property
    def row(self) -> Row:
        """The method with its inputs, knowledge and oracles."""
        return self.run.run.row

    @property
    def dataset(self) -> str:
        """What the dataset is: SUITE/NAME, or the name of its folder and its seed."""
        return dataset_title(self.run.run)

    @property
    def group(self) -> tuple[str, str]:
        """(dataset, unit): only lines of one group are compared."""
        return self.dataset, self.unit

    @property
    def best_sign(self) -> bool:
        """Whether a joint has the sign with the smaller error, which flatters and must be shown."""
        return "best" in self.sign

    @property
    def has_interval(self) -> bool:
        """Whether there are enough clusters to draw from."""
        return len(set(self.cluster.values())) >= MIN_CLUSTERS


@dataclass(frozen=True)
class Leaderboard:
    """All results, compared."""

    lines: tuple[Line, ...]
    """By dataset (in the paper's order) and unit, then by mean error."""
    differences: Mapping[tuple[int, int], Difference]
    """Paired difference a - b of two lines (by position, a < b) of one group, if they share enough
    clusters for an interval."""
    ranks: tuple[int, ...]
    """Rank of each line in its group, see `shared_ranks`; 0 of a line that lacks sequences, and of
    a published line on other sequences than the lines that it stands beside."""
    unfinished: tuple[RunFolder, ...]
    """Runs without scores: stopped, or still running."""
    published: tuple[paper.PublishedCell, ...] = paper.PUBLISHED
    """Numbers of papers, which stand beside the lines and are not ranked."""

    @property
    def groups(self) -> dict[tuple[str, str], list[int]]:
        """Positions of the lines of each group."""
        out: dict[tuple[str, str], list[int]] = {}
        for k, line in enumerate(self.lines):
            out.setdefault(line.group, []).append(k)
        return out

    def describe_unfinished(self) -> list[str]:
        """Return a line for each run without scores."""
        return [f"{f.run.row.title} on {dataset_title(f.run)}: {count_estimates(f)}"
                for f in self.unfinished]

    @property
    def labels(self) -> list[str]:
        """Label of each line, see `label_rows`."""
        return label_rows(
            [x.row for x in self.lines], [x.group for x in self.lines],
            ["published, " * bool(x.published) + x.extent for x in self.lines])


def count_estimates(folder: RunFolder) -> str:
    """Return in words how many estimates a run without scores has."""
    done = sum(folder.estimate_path(name).exists() for name in folder.run.sequences)
    return (f"{done} of {len(folder.run.sequences)} sequences estimated and none scored; the same "
            "gcbench eval continues it")


def read_leaderboard(
    results: Sequence[Path], labels: Sequence[str] = (), published: Iterable[Line] = ()
) -> Leaderboard:
    """Read and compare all results under the folders; labels are NAME=FOLDER.

    A CSV file in place of a folder holds numbers of papers (`published_numbers.read_published`).
    `published` are lines of published rows, see `build_leaderboard`.

    Raises:
        ConfigError: If a label is not of this form.
        DatasetError: If there are no scores, if two folders hold the same row with other scores, or
            if two datasets of one name and seed differ.
    """
    named: dict[Path, str] = {}
    for label in labels:
        name, equals, folder = label.partition("=")
        if not (is_label(name) and equals and folder):
            raise ConfigError(f"--label {label}: expected NAME=RESULTS_FOLDER")
        named[Path(folder).resolve()] = name
    files = [path for path in results if path.suffix.lower() == ".csv"]
    folders = [r for r in results if r not in files]
    folders += [path for path in named if path not in [r.resolve() for r in folders]]
    runs = [_add_label(run, named.get(folder.resolve(), ""))
            for folder in folders for run in find_runs(folder)]  # fmt: skip
    board = build_leaderboard(runs, published)
    if all(line.published for line in board.lines):
        where = ", ".join(map(str, folders)) or "a folder: none is given"
        there = "".join(f"; {line}" for line in board.describe_unfinished()[:1])
        raise DatasetError(f"no scores in {where}; run `gcbench eval --method NAME` first{there}")
    further = tuple(cell for file in files for cell in paper.read_published(file))
    return replace(board, published=board.published + further)


def build_leaderboard(
    folders: Iterable[RunFolder], published: Iterable[Line] = ()
) -> Leaderboard:
    """Summarize and compare runs, and lines of published rows beside them.

    Published lines on other datasets than those of the runs, or on other motions, are left out;
    without runs, all are shown. Raises DatasetError as `read_leaderboard` does.
    """
    folders = list(folders)
    scored = without_copies(f for f in folders if (f.path / SCORES).exists())
    lines = [line for folder in scored
             for line in _mark_partial(lines_of(folder, folder.scores()))]
    first: dict[tuple[str, str], Line] = {}
    for line in lines:
        like = first.setdefault(line.group, line)
        if not _have_equal_motions(like, line):
            raise DatasetError(
                f"{like.run.path} and {line.run.path} are on two datasets of one name (their "
                "motions differ); report them separately")
    lines += [line for line in published if not first or (
        (like := first.get(line.group)) and _have_equal_motions(like, line)
        and not config_differences(like.run.run.config, line.run.run.config))]
    lines.sort(key=lambda line: (
        line.dataset.rpartition("/")[0], paper.paper_order(line.robot), *line.group,
        line.summary.mean, line.row.folder, line.published,
    ))  # fmt: skip
    unfinished = tuple(f for f in folders if not (f.path / SCORES).exists())
    differences: dict[tuple[int, int], Difference] = {}
    board = Leaderboard(tuple(lines), differences, (), unfinished)
    ranked = {k for mine in board.groups.values() for k in _find_rankable(lines, mine)}
    for mine in board.groups.values():
        mine = [k for k in mine if k in ranked]
        found = compare_rows([(lines[k].error, lines[k].cluster) for k in mine])
        differences |= {(mine[a], mine[b]): d for (a, b), d in found.items()}
    ranks = shared_ranks(len(lines), differences)
    return replace(board, ranks=tuple(r * (k in ranked) for k, r in enumerate(ranks)))


def _have_equal_motions(one: Line, other: Line) -> bool:
    return have_equal_motions(one.conditions["displacement"], other.conditions["displacement"])


def _find_rankable(lines: Sequence[Line], mine: Sequence[int]) -> list[int]:
    """Return those of a group that can be ranked: the user's own, and the published lines on the
    same sequences. Where there are none of the user's, the sequences of most published lines count,
    if they suffice for an interval.
    """
    mine = [k for k in mine if lines[k].published or not lines[k].extent]
    own = [k for k in mine if not lines[k].published]
    if not mine:
        return []
    number = Counter(lines[k].sequences for k in own or mine)
    same = max(number, key=lambda names: (
        len(names) >= MIN_CLUSTERS, number[names], len(names), sorted(names)))
    return [k for k in mine if k in own or lines[k].sequences == same]


def _mark_partial(lines: Sequence[Line]) -> list[Line]:
    """The lines of one run; if sequences have no scores, with their `extent`."""
    scored = {name for line in lines for name in line.sequences}
    return [line if scored >= {*line.run.run.sequences} else
            replace(line, extent=f"{len(scored)} of {len(line.run.run.sequences)} sequences")
            for line in lines]


def lines_of(folder: RunFolder, scores: pandas.DataFrame) -> list[Line]:
    """Return the lines of one run from its scores: one for each unit in which its joints move."""
    name = scores["sequence"]
    scores = scores.iloc[np.lexsort((  # the order in the file changes no number
        scores["frame"], scores["metric"].cat.codes, scores["joint_index"], name.cat.codes,
        name.str.len(),
    ))]
    finals = scores[scores["metric"] == "final_error"]
    return [_line(folder, unit, finals[finals["unit"] == unit], scores)
            for unit in sorted({*finals["unit"]})]


def _line(
    folder: RunFolder, unit: str, finals: pandas.DataFrame, scores: pandas.DataFrame
) -> Line:
    mine = scores[scores["joint"].isin({"", *finals["joint"]})]
    of = {str(metric): rows for metric, rows in mine.groupby("metric", observed=True)}
    value = {metric: dict(zip(_pairs(of[metric]), of[metric]["value"], strict=True))
             for metric in ("covered", "sigma", "reliable", *CONDITIONS) if metric in of}
    covered = {pair: share > 0.5 for pair, share in value.get("covered", {}).items()}
    error = dict(zip(_pairs(finals), finals["value"], strict=True))
    drift = of["error"].groupby("frame")["value"] if "error" in of else ()
    means = {metric: np.asarray(of[metric]["value"]) for metric in sorted(SECONDARY)
             if metric in of}
    failed = finals[finals["status"] != "ok"]
    return Line(
        run=folder,
        unit=unit,
        robot=Path(str(folder.run.config.get("robot", ""))).stem,
        summary=_summary(finals, covered, unit),
        error=error,
        cluster=dict(zip(_pairs(finals), finals["cluster"], strict=True)),
        joints=tuple(
            JointScore(name, index, _summary(finals[finals["joint"] == name], covered, unit))
            for index, name in sorted({*zip(finals["joint_index"], finals["joint"], strict=True)})
        ),
        drift=(0.0, *(float(np.mean(errors.to_numpy())) for _, errors in drift)),
        curve=pcp(np.asarray(finals["value"]), _flags(finals, covered), CURVE_THRESHOLDS[unit]),
        means={metric: float(np.mean(x[np.isfinite(x)])) for metric, x in means.items()
               if np.isfinite(x).any()},
        calibration=calibrate(error, value, unit),
        sign="+".join(sorted({*finals["sign"]} - {""})),
        conditions={metric: value.get(metric, {}) for metric in CONDITIONS},
        failed=dict(zip(failed["sequence"], failed["status"], strict=True)),
    )


def _pairs(rows: pandas.DataFrame) -> Iterator[SequenceJoint]:
    return zip(rows["sequence"], rows["joint"], strict=True)


def _flags(rows: pandas.DataFrame, flag: Mapping[SequenceJoint, bool]) -> NDArray[np.bool_]:
    return np.array([flag.get(pair, False) for pair in _pairs(rows)])


def _summary(
    finals: pandas.DataFrame, covered: Mapping[SequenceJoint, bool], unit: str
) -> ErrorSummary:
    return summarize(
        finals["value"], _flags(finals, covered), [*finals["cluster"]], [*finals["sequence"]],
        pcp_thresholds(unit), np.random.default_rng(SEED),
    )


def _add_label(folder: RunFolder, label: str) -> RunFolder:
    """Add a label to the name of the method."""
    row = folder.run.row
    if not label:
        return folder
    row = replace(row, method=f"{row.method} ({label})")
    return replace(folder, run=replace(folder.run, row=row))
