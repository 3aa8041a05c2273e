"""The leaderboard: one line for each row on each dataset, from the score tables alone."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import GcbenchError
from ...renderer.scene import differences as config_differences
from ..protocol import PCP_DEGREES
from ..results import SCORES, Result, Row, Run, RunFolder, find_runs
from . import published_numbers as paper
from .standings import SEED, thresholds
from .statistics import Difference, Pair, Summary, paired_difference, pcp, summarize

PCP5 = PCP_DEGREES.index(5.0)
THRESHOLDS: dict[str, tuple[float, ...]] = {
    "deg": tuple(sorted({*PCP_DEGREES, *(float(f"{x:.3g}") for x in np.geomspace(0.02, 90, 110))}))
}
"""Where the PCP curves are read, by unit; prismatic joints are in m, a cm for each degree."""
THRESHOLDS["m"] = tuple(float(f"{x / 100:.5g}") for x in THRESHOLDS["deg"])
SECONDARY = ("mean_error", "step_error", "axis_direction", "axis_distance", "within_sigma",
             "part_miou", "peak_memory", "seconds_per_frame")  # fmt: skip
"""Metrics of which a line shows the mean over joints (or sequences) that have them."""


@dataclass(frozen=True)
class JointScore:
    """Final errors of one joint."""

    name: str
    index: int
    """1 .. J from the base outward."""
    summary: Summary


@dataclass(frozen=True)
class Line:
    """One row on one dataset, in one unit: deg, or m for prismatic joints."""

    run: RunFolder
    unit: str
    robot: str
    """Name without folders."""
    summary: Summary
    error: Mapping[Pair, float]
    """Final error of each (sequence, joint)."""
    cluster: Mapping[Pair, str]
    joints: tuple[JointScore, ...]
    drift: tuple[float, ...]
    """[T] mean error at each frame."""
    curve: tuple[float, ...]
    """Percent of pairs within each of THRESHOLDS."""
    means: Mapping[str, float]
    """Of SECONDARY, as far as there are any."""
    sign: str
    """Who decided the signs: given, screw, best; several joined by "+"."""
    failed: Mapping[str, str]
    """Status of each sequence that failed."""

    @property
    def row(self) -> Row:
        """What was run."""
        return self.run.run.row

    @property
    def dataset(self) -> str:
        """Name of the dataset."""
        return self.run.run.dataset

    @property
    def group(self) -> tuple[str, str]:
        """(dataset, unit): lines of one group can be compared."""
        return self.dataset, self.unit


@dataclass(frozen=True)
class Board:
    """All results."""

    lines: tuple[Line, ...]
    """By dataset (in the paper's order) and unit, and there by mean error."""
    unfinished: tuple[RunFolder, ...]
    """Runs that have no scores yet: they were stopped, or are on their way."""


def read_board(results: Sequence[Path]) -> Board:
    """Everything under the folders.

    Raises GcbenchError if there are no scores, if two folders hold the same row, or if two
    datasets of one name are not the same.
    """
    folders = find_runs(results)
    scored = [folder for folder in folders if (folder.path / SCORES).exists()]
    _check_same(scored)
    lines = [line for folder in scored for line in lines_of(folder, folder.results())]
    if not lines:
        where = ", ".join(str(path) for path in results)
        raise GcbenchError(f"no scores in {where}; run `gcbench eval --method NAME` first")
    lines.sort(key=lambda line: (
        line.dataset.rpartition("/")[0], paper.order(line.robot), *line.group, line.summary.mean,
        line.row.folder,
    ))  # fmt: skip
    return Board(tuple(lines), tuple(folder for folder in folders if folder not in scored))


def labels_of(lines: Sequence[Line]) -> list[str]:
    """Method, inputs and knowledge of each line; and its version where that would not do."""

    def words(row: Row) -> list[str]:
        return [row.name, *(w for w in (row.inputs, row.knowledge) if w != "none")]

    plain = [" · ".join(words(line.row)) for line in lines]
    taken = Counter((line.group, label) for line, label in zip(lines, plain, strict=True))
    twice = {label for (_, label), n in taken.items() if n > 1}
    return [f"{label} · {line.row.version}" if label in twice else label
            for line, label in zip(lines, plain, strict=True)]  # fmt: skip


def lines_of(folder: RunFolder, results: Iterable[Result]) -> list[Line]:
    """The lines of one run: one for each unit in which its joints move."""
    rows = list(results)
    finals: dict[str, list[Result]] = defaultdict(list)
    for r in rows:
        if r.metric == "final_error":
            finals[r.unit].append(r)
    return [_line(folder, unit, finals[unit], rows) for unit in sorted(finals)]


def _line(folder: RunFolder, unit: str, finals: list[Result], rows: list[Result]) -> Line:
    pairs = [(r.sequence, r.joint) for r in finals]
    names = {r.joint for r in finals}
    mine = [r for r in rows if not r.joint or r.joint in names]
    covered = {(r.sequence, r.joint): r.value > 0.5 for r in mine if r.metric == "covered"}
    known = np.array([covered.get(pair, False) for pair in pairs])
    error = np.array([r.value for r in finals])
    drift: dict[int, list[float]] = defaultdict(list)
    means: dict[str, list[float]] = defaultdict(list)
    for r in mine:
        if r.metric == "error":
            drift[r.frame].append(r.value)
        elif r.metric in SECONDARY and np.isfinite(r.value):
            means[r.metric].append(r.value)
    return Line(
        run=folder,
        unit=unit,
        robot=_robot(folder.run),
        summary=_summary(finals, covered, unit),
        error={pair: float(value) for pair, value in zip(pairs, error, strict=True)},
        cluster={pair: r.cluster for pair, r in zip(pairs, finals, strict=True)},
        joints=tuple(
            JointScore(name, index, _summary([r for r in finals if r.joint == name], covered, unit))
            for index, name in sorted({(r.joint_index, r.joint) for r in finals})
        ),
        drift=(0.0, *(float(np.mean(drift[t])) for t in sorted(drift))),
        curve=pcp(error, known, THRESHOLDS[unit]),
        means={name: float(np.mean(values)) for name, values in sorted(means.items())},
        sign="+".join(sorted({r.sign for r in finals if r.sign})),
        failed={r.sequence: r.status for r in finals if r.status != "ok"},
    )


def _summary(finals: list[Result], covered: Mapping[Pair, bool], unit: str) -> Summary:
    return summarize(
        [r.value for r in finals],
        [covered.get((r.sequence, r.joint), False) for r in finals],
        [r.cluster for r in finals],
        [r.sequence for r in finals],
        thresholds(unit),
        np.random.default_rng(SEED),
    )


def _robot(run: Run) -> str:
    return Path(str(run.config.get("robot", ""))).stem


def _check_same(folders: Sequence[RunFolder]) -> None:
    """Raises GcbenchError unless each row is there once, and a dataset's name means one dataset."""
    rows: dict[tuple[Row, str], Path] = {}
    first: dict[str, RunFolder] = {}
    for folder in folders:
        run = folder.run
        other = rows.setdefault((run.row, run.dataset), folder.path)
        if other is not folder.path:
            raise GcbenchError(f"{other} and {folder.path} are the same row; report one of them")
        like = first.setdefault(run.dataset, folder)
        if changes := config_differences(like.run.config, run.config):
            raise GcbenchError(
                f"{like.path} and {folder.path} are on two datasets of one name ({changes[0]}); "
                "report them apart"
            )


def compare(lines: Sequence[Line]) -> dict[tuple[int, int], Difference]:
    """Paired difference a - b of each two lines (a < b) of one group that share two clusters."""
    seed = int(np.random.default_rng(SEED).integers(2**63))  # the same draws for each comparison
    found: dict[tuple[int, int], Difference] = {}
    for b, second in enumerate(lines):
        for a, first in enumerate(lines[:b]):
            if first.group != second.group:
                continue
            rng = np.random.default_rng(seed)
            difference = paired_difference(first.error, second.error, rng, first.cluster)
            if difference.clusters > 1:  # an interval of one cluster says nothing
                found[a, b] = difference
    return found


def ranks(lines: Sequence[Line], differences: Mapping[tuple[int, int], Difference]) -> list[int]:
    """Rank of each line in its group: 1 + the number of lines that are better and told apart."""
    out = [1] * len(lines)
    for (a, b), difference in differences.items():
        if difference.told_apart:
            out[a if difference.mean > 0.0 else b] += 1
    return out


def sequence_errors(line: Line) -> dict[str, float]:
    """Mean final error of each sequence."""
    errors: dict[str, list[float]] = defaultdict(list)
    for (sequence, _), value in line.error.items():
        errors[sequence].append(value)
    return {name: float(np.mean(errors[name])) for name in sorted(errors)}
