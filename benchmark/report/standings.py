"""Scores summed up: a line for each dataset, row and unit, with intervals and shared ranks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..protocol import PCP_DEGREES
from ..results import Result
from .statistics import Pair, Summary, shared_ranks, summarize

SEED = 0
"""Of the bootstrap: a table is a function of its results."""


@dataclass(frozen=True)
class Standing:
    """One row on one dataset, in one unit."""

    dataset: str
    method: str
    """With oracles."""
    inputs: str
    knowledge: str
    oracles: str
    training: str
    version: str
    unit: str
    """deg or m"""
    rank: int
    """Among the rows on this dataset, in this unit; shared by those that cannot be told apart."""
    summary: Summary
    """Of final errors."""
    seconds_per_frame: float | None
    """Mean over sequences; None if unknown."""
    signs: tuple[str, ...]
    """How signs were decided, see `Result.sign`; "best" flatters and is to be said."""


def standings(results: Iterable[Result]) -> list[Standing]:
    """Sorted by dataset and unit, then by mean final error."""
    groups: dict[tuple[str, str], dict[tuple[str, ...], list[Result]]] = defaultdict(dict)
    covered: dict[tuple[str, ...], bool] = {}
    seconds: dict[tuple[str, ...], list[float]] = defaultdict(list)
    for r in results:
        row = (r.method, r.inputs, r.knowledge, r.oracles, r.training, r.version)
        if r.metric == "final_error":
            groups[r.dataset, r.unit].setdefault(row, []).append(r)
        elif r.metric == "covered":
            covered[(r.dataset, *row, r.sequence, r.joint)] = r.value > 0
        elif r.metric == "seconds_per_frame":
            seconds[(r.dataset, *row)].append(r.value)
    out: list[Standing] = []
    for (dataset, unit), rows in sorted(groups.items()):
        errors = [{pair_of(r): r.value for r in lines} for lines in rows.values()]
        clusters = {pair_of(r): r.cluster for lines in rows.values() for r in lines}
        ranks = shared_ranks(errors, np.random.default_rng(SEED), clusters)
        here: list[Standing] = []
        for (row, lines), rank in zip(rows.items(), ranks, strict=True):
            times = seconds[(dataset, *row)]
            summary = summarize(
                [r.value for r in lines],
                [covered.get((dataset, *row, r.sequence, r.joint), False) for r in lines],
                [r.cluster for r in lines],
                [r.sequence for r in lines],
                thresholds(unit),
                np.random.default_rng(SEED),
            )
            method, inputs, knowledge, oracles, training, version = row
            here.append(
                Standing(
                    dataset, method, inputs, knowledge, oracles, training, version, unit, rank,
                    summary, float(np.mean(times)) if times else None,
                    tuple(sorted({r.sign for r in lines})),
                )
            )  # fmt: skip
        out += sorted(here, key=lambda s: s.summary.mean)
    return out


def thresholds(unit: str) -> tuple[float, ...]:
    """Of PCP, in the unit of the errors: 1, 2, 5, 10 deg, or as many cm (in m)."""
    return tuple(d / 100.0 for d in PCP_DEGREES) if unit == "m" else PCP_DEGREES


def pair_of(result: Result) -> Pair:
    """What paired comparisons go by."""
    return result.sequence, result.joint


def text(lines: Iterable[Standing]) -> str:
    """The standings for a terminal."""
    head = (
        "dataset", "rank", "method", "inputs", "knowledge", "mean +- std", "95 % of the mean",
        "median", "PCP@5", "coverage", "s/frame",
    )  # fmt: skip
    cells: list[tuple[str, ...]] = [head]
    for s in lines:
        m, f = s.summary, 100.0 if s.unit == "m" else 1.0
        unit = "cm" if s.unit == "m" else "deg"
        note = " (best sign)" if "best" in s.signs else ""
        time = "" if s.seconds_per_frame is None else f"{s.seconds_per_frame:.3g}"
        cells.append((
            s.dataset, str(s.rank), s.method, s.inputs, s.knowledge + note,
            f"{f * m.mean:.2f} +- {f * m.std:.2f} {unit}",
            f"{f * m.ci_low:.2f} .. {f * m.ci_high:.2f}", f"{f * m.median:.2f}",
            f"{m.pcp[2]:.1f} %", f"{m.coverage:.0f} %", time,
        ))  # fmt: skip
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    return "\n".join(
        "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip()
        for row in cells
    )
