"""`gcbench report`: results as one static page, Markdown, CSV and LaTeX."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ... import __version__
from ...errors import GcbenchError
from ...renderer.show import render_page
from ...robots.files import write_atomically
from ..protocol import PCP_DEGREES
from .about import about, failures
from .formats import leaderboard_csv, leaderboard_md, one_line, tables_tex
from .gallery import Picture, chosen, draw
from .leaderboard import (
    PCP5,
    SECONDARY,
    THRESHOLDS,
    Board,
    Line,
    compare,
    labels_of,
    ranks,
    read_board,
)
from .standings import thresholds
from .statistics import Difference
from .tables import Table, paper_tables

FILES = ("index.html", "leaderboard.md", "leaderboard.csv", "tables.tex")
TEMPLATE = Path(__file__).parent / "report.html"
MAX_FAILURES = 200
"""Failures that a page lists."""
_MORE = {
    "mean_error": ("mean over frames", "error", "error averaged over all frames but the first"),
    "step_error": ("per step", "error", "error of the motion from frame to frame"),
    "axis_direction": ("axis °", "number", "angle of the returned axis to the true one"),
    "axis_distance": ("axis m", "number", "distance of the returned axis from the joint"),
    "within_sigma": ("within σ", "share", "final errors of at most the standard deviation that "
                     "the method gives; 68 % if that is calibrated"),
    "part_miou": ("part mIoU", "share", "estimated parts against the true ones"),
    "peak_memory": ("MiB", "number", "peak memory of the process"),
}  # fmt: skip


def report(
    results: Sequence[Path] = (Path("results"),),
    out: Path = Path("report"),
    pictures: bool = True,
    progress: bool = True,
) -> list[Path]:
    """Write the report of all results under the folders into the folder `out`.

    Returns the paths of FILES. Without `pictures` no sequence is drawn. The same results give the
    same files. Raises GcbenchError if there are no results, or if a file cannot be written.
    """
    board = read_board(results)
    lines = board.lines
    differences = compare(lines)
    tables = paper_tables(lines)
    found = draw(lines, chosen(lines), progress) if pictures else []
    contents = (
        render_page(TEMPLATE, page_data(board, differences, tables, found)),
        leaderboard_md(lines, ranks(lines, differences), __version__),
        leaderboard_csv(lines),
        tables_tex(tables, __version__),
    )
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, text in zip(FILES, contents, strict=True):
            write_atomically(out / name, text.encode())
    except OSError as error:
        raise GcbenchError(f"cannot write to {out}: {error.strerror or error}") from error
    return [out / name for name in FILES]


def page_data(
    board: Board,
    differences: Mapping[tuple[int, int], Difference],
    tables: Sequence[Table],
    pictures: Sequence[Picture],
) -> dict[str, Any]:
    """Everything that the page's script reads, as JSON values."""
    lines = board.lines
    groups = list(dict.fromkeys(line.group for line in lines))
    failed = failures(board)
    return {
        "version": __version__,
        "facts": _facts(lines),
        "groups": [_group([x for x in lines if x.group == group]) for group in groups],
        "lines": [
            _line(k, line, label, groups.index(line.group))
            for k, (line, label) in enumerate(zip(lines, labels_of(lines), strict=True))
        ],
        "pairs": {
            f"{a} {b}": {"mean": _short(d.mean), "low": _short(d.ci_low), "high": _short(d.ci_high),
                         "sequences": _common(lines[a], lines[b])}
            for (a, b), d in differences.items()
        },
        "pcp_columns": [
            {"key": f"pcp{limit:g}", "title": f"PCP@{limit:g}", "more": limit != PCP_DEGREES[PCP5]}
            for limit in PCP_DEGREES
        ],
        "more_columns": [
            {"key": key, "title": title, "kind": kind, "says": says, "down": kind == "share"}
            for key, (title, kind, says) in _MORE.items()
        ],
        "thresholds": THRESHOLDS,
        "listed": {unit: thresholds(unit) for unit in THRESHOLDS},
        "tables": [asdict(table) for table in tables],
        "gallery": [{**asdict(p), "error": _short(p.error),
                     "joints": [[name, _short(error)] for name, error in p.joints]}
                    for p in pictures],
        "about": [{"title": title, "rows": rows} for title, rows in about(lines)],
        "failures": failed[:MAX_FAILURES],
        "failed": len(failed),
    }  # fmt: skip


def _line(number: int, line: Line, label: str, group: int) -> dict[str, Any]:
    s, row = line.summary, line.row
    sure = len(set(line.cluster.values())) > 1
    limits = zip(PCP_DEGREES, s.pcp, strict=True)
    return {
        "id": number,
        "group": group,
        "label": one_line(label),
        "dataset": one_line(line.dataset),
        "method": one_line(row.name),
        "inputs": row.inputs,
        "knowledge": row.knowledge,
        "training": one_line(row.training),
        "version": one_line(row.version),
        "oracles": ", ".join(row.oracles),
        "sign": line.sign,
        "unit": line.unit,
        "sequences": s.sequences,
        "joints": s.joints,
        "expected": len(line.run.run.sequences),
        "mean": _short(s.mean),
        "std": _short(s.std),
        "low": _short(s.ci_low) if sure else None,
        "high": _short(s.ci_high) if sure else None,
        "median": _short(s.median),
        "p90": _short(s.p90),
        **{f"pcp{limit:g}": _short(share / 100) for limit, share in limits},
        "coverage": _short(s.coverage / 100),
        "seconds": _short(line.means.get("seconds_per_frame")),
        **{key: _short(line.means.get(key)) for key in SECONDARY if key != "seconds_per_frame"},
        "failed": len(line.failed),
        "drift": [float(f"{x:.5g}") for x in line.drift],
        "curve": [float(f"{x / 100:.5g}") for x in line.curve],
    }


def _group(lines: Sequence[Line]) -> dict[str, Any]:
    line = lines[0]
    run = line.run.run
    prismatic = line.unit == "m"
    facts = [f"{len(run.sequences)} sequences of {len(line.drift)} frames",
             ", ".join(one_line(joint.name) for joint in line.joints)]  # fmt: skip
    return {
        "title": one_line(line.dataset) + (" (prismatic joints)" if prismatic else ""),
        "unit": line.unit,
        "threshold": thresholds(line.unit)[PCP5],
        "facts": " · ".join(facts),
    }


def _facts(lines: Sequence[Line]) -> str:
    def plural(n: int, word: str) -> str:
        return f"{n} {word}{'' if n == 1 else 's'}"

    sequences = {(line.dataset, name) for line in lines for name in line.run.run.sequences}
    return " · ".join([
        plural(len({line.row.name for line in lines}), "method"),
        plural(len({line.dataset for line in lines}), "dataset"),
        plural(len(sequences), "sequence"),
        plural(len({(line.row, line.dataset) for line in lines}), "row"),
    ])  # fmt: skip


def _common(a: Line, b: Line) -> int:
    return len({sequence for sequence, _ in a.error.keys() & b.error.keys()})


def _short(x: float | None) -> float | None:
    """Nine digits, so that the page rounds as the tables do; None if it is no finite number."""
    return float(f"{x:.9g}") if x is not None and math.isfinite(x) else None
