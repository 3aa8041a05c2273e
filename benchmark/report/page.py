"""Write a report of results as one static HTML page, Markdown, CSV and LaTeX."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ... import __version__
from ...errors import DatasetError, GcbenchError
from ...renderer.runtime import plural, require_local, say
from ...renderer.show import render_page
from ...robots.files import remove_leftovers, write_atomically
from ..protocol import PCP5, PCP_DEGREES, pcp_thresholds
from ..results import EstimateShape, Results, RunFolder, read_stored
from .calibration import LEVELS
from .conditions import error_by_condition
from .copies import dataset_title
from .figure import CAPTION, FIGURE, draw_figure
from .formats import latex_figure, leaderboard_csv, one_line, tables_csv, to_latex, to_markdown
from .gallery import Picture, draw_pictures, select_pictures, write_pages
from .leaderboard import Leaderboard, build_leaderboard, count_estimates, read_leaderboard
from .lines import CURVE_THRESHOLDS, SECONDARY, Line
from .provenance import provenance
from .published_rows import PUBLISHED_ROWS
from .tables import leaderboard_tables, paper_tables, suite_tables

FILES = ("index.html", "leaderboard.md", "leaderboard.csv", "tables.tex", "tables.csv")
_TEMPLATE = Path(__file__).parent / "report.html"
_MAX_FAILURES = 200
"""Largest number of failures on the page."""
_MAX_REASON = 400
"""Largest number of characters of a reason; its end is shown, which contains the error."""
_MORE = {
    "mean_error": ("mean over frames", "error", "error averaged over all frames but the first"),
    "step_error": ("per step", "error", "error of the motion from frame to frame"),
    "axis_direction": ("axis °", "number", "angle of the returned axis to the true one"),
    "axis_distance": ("axis m", "number", "distance of the returned axis from the joint"),
    "within_sigma": ("within σ", "share", "final errors of at most the standard deviation that "
                     "the method gives; 68 % if that is calibrated"),
    "reliable": ("reliable", "share", "joints that the method says can be believed"),
    "part_miou": ("part mIoU", "share", "estimated parts against the true ones"),
    "peak_memory": ("MiB", "number", "peak memory of the process"),
}
_Failure = tuple[str, str, str, str, str]
"""Row, dataset, sequence, status, reason."""


@dataclass(frozen=True)
class ReportOptions:
    """What a report of results folders reads."""

    labels: Sequence[str] = ()
    """NAME=FOLDER adds NAME to the methods of a results folder, so that two folders with the same
    row can be compared. Copies with equal scores count once without a label."""
    published: str | Path | None = PUBLISHED_ROWS
    """Folder of published rows; None shows none. Default: those of this package."""
    allow_model: bool = False
    """Read models from paths that the datasets name, or download them."""


def report(
    results: Results | str | Path | Sequence[str | Path] = "results",
    out: str | Path = "report",
    pictures: bool = True,
    progress: bool = True,
    options: ReportOptions = ReportOptions(),
) -> list[Path]:
    """Write a report of results: one static page, and tables as Markdown, CSV and LaTeX.

    With pictures, pages of the sequences with the largest errors are written beside it, and an
    image in the form of the paper's figure 3.

    Equal results give identical files. Published rows on the same datasets stand beside those of
    results folders, and are ranked where the sequences are the same; the return value of `evaluate`
    or `score` is reported alone.

    Args:
        results: The return value of `evaluate` or `score`, or one or more results folders, and CSV
            files with numbers of papers (columns method, robot, mean, and joint, std, pcp5 where
            there are), which stand beside ours and are not ranked.
        out: Folder of the report.
        pictures: Draw the worst and the median sequence of each row (needs a renderer), of at most
            48 rows, and write pages of at most 16 worst sequences to `out`/sequences.
        progress: Show a progress bar on stderr.
        options: Labels of folders, published rows, and models to read.

    Returns:
        The paths of the page, the Markdown, the CSV and the LaTeX file, and of the tables in the
        paper's form as CSV.

    Raises:
        ConfigError: If a label is not of this form, or a file is a table of scores.
        DatasetError: If there are no scores or they cannot be combined, or `out` is not writable.

    Example:
        >>> import gcbench as gb
        >>> [path.name for path in gb.report("results", "report", progress=False)]
        ['index.html', 'leaderboard.md', 'leaderboard.csv', 'tables.tex', 'tables.csv']
    """
    require_local(Path(out), "--out")
    if isinstance(results, Results):
        board = build_leaderboard(results.runs)
    else:
        folders = [results] if isinstance(results, str | Path) else results
        beside = None if options.published is None else Path(options.published)
        board = read_leaderboard([Path(folder) for folder in folders], options.labels, beside)
    return write_report(board, Path(out), pictures, progress, options.allow_model)


def write_report(
    board: Leaderboard, out: Path, pictures: bool, progress: bool, allow_model: bool
) -> list[Path]:
    """Write the report of a leaderboard; see `report`."""
    chosen = select_pictures(board.lines) if pictures else []
    found = draw_pictures(board.lines, chosen, progress, allow_model)
    if progress:
        for line in board.describe_unfinished():
            say(f"not in the report: {line}")
        for line in board.describe_unranked():
            say(f"without a rank: {line}")
        if robots := board.robots_without_results:
            say(f"not in the report: numbers of papers on {', '.join(robots)}, on which there are "
                "no results")
    found = write_pages(board.lines, found, out, progress)
    figure = draw_figure(board.lines, board.labels, found)
    contents = (
        report_page(board, found),
        to_markdown({"Leaderboard": suite_tables(board) + leaderboard_tables(board),
                     "Tables in the paper's form": paper_tables(board)}, __version__,
                    board.describe_unfinished())
        + (f"\n![{CAPTION}]({FIGURE})\n" if figure else ""),
        leaderboard_csv(board),
        to_latex(paper_tables(board), __version__) + (latex_figure(FIGURE, CAPTION) * bool(figure)),
        tables_csv(paper_tables(board)),
    )
    try:
        out.mkdir(parents=True, exist_ok=True)
        remove_leftovers(out)
        for name, text in zip(FILES, contents, strict=True):
            write_atomically(out / name, text.encode())
        if figure:
            write_atomically(out / FIGURE, figure)
        else:
            (out / FIGURE).unlink(missing_ok=True)  # of an earlier report
    except OSError as error:
        raise DatasetError(f"cannot write to {out}: {error.strerror or error}") from error
    return [out / name for name in FILES]


def report_page(board: Leaderboard, pictures: Sequence[Picture]) -> str:
    """Return the report as one HTML page without references to other files."""
    return render_page(_TEMPLATE, _page_data(board, pictures))


def _page_data(board: Leaderboard, pictures: Sequence[Picture]) -> dict[str, Any]:
    """Return the data for the script of the page, as a JSON object."""
    lines, groups = board.lines, board.groups
    failed = _failures(board)
    return {
        "version": __version__,
        "facts": _facts(lines),
        "groups": [_group([lines[k] for k in mine]) for mine in groups.values()],
        "lines": [
            {**_line(k, line, label, list(groups).index(line.group)), "ranked": board.ranks[k] > 0,
             "repeated": k in board.repeated}
            for k, (line, label) in enumerate(zip(lines, board.labels, strict=True))
        ],
        "pairs": {
            f"{a} {b}": {"mean": _short(d.mean), "low": _short(d.ci_low), "high": _short(d.ci_high),
                         "sequences": _common(lines[a], lines[b]),
                         "significant": d.is_significant}
            for (a, b), d in board.differences.items()
        },
        "pcp_columns": [
            {"key": f"pcp{limit:g}", "title": f"PCP@{limit:g}", "more": limit != PCP_DEGREES[PCP5]}
            for limit in PCP_DEGREES
        ],
        "more_columns": [
            {"key": key, "title": title, "kind": kind, "says": says, "down": kind == "share"}
            for key, (title, kind, says) in _MORE.items()
        ],
        "thresholds": CURVE_THRESHOLDS,
        "levels": LEVELS,
        "listed": {unit: pcp_thresholds(unit) for unit in CURVE_THRESHOLDS},
        "suites": [asdict(table) for table in suite_tables(board)],
        "tables": [asdict(table) for table in paper_tables(board)],
        "gallery": [{**asdict(p), "error": _short(p.error), "command": one_line(p.command),
                     "joints": [[name, _short(error)] for name, error in p.joints]}
                    for p in pictures],
        "about": [{"title": title, "rows": rows} for title, rows in provenance(lines)],
        "failures": failed[:_MAX_FAILURES],
        "failed": len(failed),
    }


def _line(number: int, line: Line, label: str, group: int) -> dict[str, Any]:
    s, row = line.summary, line.row
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
        "published": line.published,
        "extent": line.extent,
        "authors": one_line(line.run.run.attribution.authors),
        "link": line.run.run.attribution.link,
        "date": line.run.run.attribution.date,
        "sign": line.sign,
        "unit": line.unit,
        "sequences": s.sequences,
        "joints": s.joints,
        "expected": len(line.run.run.sequences),
        "mean": _short(s.mean),
        "std": _short(s.std),
        "low": _short(s.ci_low) if line.has_interval else None,
        "high": _short(s.ci_high) if line.has_interval else None,
        "median": _short(s.median),
        "p90": _short(s.p90),
        **{f"pcp{limit:g}": _short(share / 100) for limit, share in limits},
        "coverage": _short(s.coverage / 100),
        "seconds": _short(line.means.get("seconds_per_frame")),
        **{key: _short(line.means.get(key)) for key in SECONDARY if key != "seconds_per_frame"},
        "failed": len(line.failed),
        "drift": [float(f"{x:.5g}") for x in line.drift],
        "curve": [float(f"{x / 100:.5g}") for x in line.curve],
        "answers": dict(line.answers),
        "calibration": None if line.calibration is None else {
            **asdict(line.calibration), "large_reliable": line.calibration.large_reliable},
    }


def _group(lines: Sequence[Line]) -> dict[str, Any]:
    line = lines[0]
    run = line.run.run
    prismatic = line.unit == "m"
    facts = [f"{len(run.sequences)} sequences of {len(line.drift)} frames",
             ", ".join(one_line(joint.name) for joint in line.joints)]
    return {
        "title": one_line(line.dataset) + (" (prismatic joints)" if prismatic else ""),
        "unit": line.unit,
        "conditions": error_by_condition(lines),
        "threshold": pcp_thresholds(line.unit)[PCP5],
        "facts": " · ".join(facts),
    }


def _facts(lines: Sequence[Line]) -> str:
    sequences = {(line.dataset, name) for line in lines for name in line.run.run.sequences}
    return " · ".join([
        plural(len({line.row.name for line in lines}), "method"),
        plural(len({line.dataset for line in lines}), "dataset"),
        plural(len(sequences), "sequence"),
        plural(len({(line.row, line.dataset) for line in lines}), "row"),
    ])


def _common(a: Line, b: Line) -> int:
    return len({sequence for sequence, _ in a.error.keys() & b.error.keys()})


def _short(x: float | None) -> float | None:
    """Round to nine digits, so that page and tables round alike; None if not finite."""
    return float(f"{x:.9g}") if x is not None and math.isfinite(x) else None


def _failures(board: Leaderboard) -> list[_Failure]:
    """List the failed sequences, the sequences without a score and the unfinished runs."""
    out: list[_Failure] = [
        (one_line(folder.run.row.title), one_line(dataset_title(folder.run)), "", "unfinished",
         count_estimates(folder)) for folder in board.unfinished]
    own = [line for line in board.lines if not line.published]
    for folder in {str(line.run.path): line.run for line in own}.values():
        mine = [line for line in own if line.run.path == folder.path]
        bad = {name: status for line in mine for name, status in line.failed.items()}
        scored = {name for line in mine for name, _ in line.error}
        bad |= {name: "not scored" for name in folder.run.sequences if name not in scored}
        row, dataset = one_line(folder.run.row.title), one_line(dataset_title(folder.run))
        out += [(row, dataset, name, bad[name], _reason(folder, name)) for name in sorted(bad)]
    return out


def _reason(folder: RunFolder, name: str) -> str:
    try:
        stored = read_stored(folder.estimate_path(name), EstimateShape(1, 1, 1, 1))
    except GcbenchError as error:
        return one_line(str(error))
    reason = one_line(stored.reason)
    return reason if len(reason) <= _MAX_REASON else "…" + reason[-_MAX_REASON:]
