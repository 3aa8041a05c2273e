"""Lines of the leaderboard: the score of one row on one dataset in one unit, from its scores."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..protocol import PCP_DEGREES, pcp_thresholds
from ..results import Row, RunFolder
from .calibration import Calibration, calibrate
from .copies import dataset_title
from .statistics import MIN_CLUSTERS, SEED, ErrorSummary, SequenceJoint, pcp, summarize

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
OPTIONAL = ("within_sigma", "reliable", "axis_direction", "axis_distance")
"""Those of them that a method may leave out, for some joints too."""
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
    answers: Mapping[str, int]
    """Number of (sequence, joint) pairs with each metric of OPTIONAL that the scores contain."""
    published: str = ""
    """Date of a published row, a reference beside the user's own; else empty."""
    extent: str = ""
    """Number of sequences of each dataset of a published row, and of a row on other sequences than
    most, as "n = 20"; of a row whose scores lack some, as "5 of 6 sequences"; else empty."""

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


def name_count(counts: Collection[int]) -> str:
    """Return numbers of sequences in words: "n = 20", or "n = 5 to 20"."""
    least, most = min(counts), max(counts)
    return f"n = {least}" + f" to {most}" * (most > least)


def lines_of(folder: RunFolder, scores: pandas.DataFrame) -> list[Line]:
    """Return the lines of one run from its scores: one for each unit in which its joints move."""
    name = scores["sequence"]
    scores = scores.iloc[np.lexsort((  # the order in the file changes no number
        scores["frame"], scores["metric"].cat.codes, scores["joint_index"], name.cat.codes,
        name.str.len(),
    ))]
    finals = scores[scores["metric"] == "final_error"]
    return [_line(folder, unit, finals.loc[finals["unit"] == unit, :], scores)
            for unit in sorted({*finals["unit"]})]


def _line(
    folder: RunFolder, unit: str, finals: pandas.DataFrame, scores: pandas.DataFrame
) -> Line:
    mine = scores.loc[scores["joint"].isin({"", *finals["joint"]}), :]
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
            JointScore(name, index, _summary(finals.loc[finals["joint"] == name, :], covered, unit))
            for index, name in sorted({*zip(finals["joint_index"], finals["joint"], strict=True)})
        ),
        drift=(0.0, *(float(np.mean(errors.to_numpy())) for _, errors in drift)),
        curve=pcp(np.asarray(finals["value"]), _flags(finals, covered), CURVE_THRESHOLDS[unit]),
        means={metric: float(np.mean(x[np.isfinite(x)])) for metric, x in means.items()
               if np.isfinite(x).any()},
        calibration=calibrate(error, value, unit),
        sign="+".join(sorted({*finals["sign"]} - {""})),
        answers={metric: int(np.isfinite(means[metric]).sum()) for metric in OPTIONAL
                 if metric in means},
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
