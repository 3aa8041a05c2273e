"""The report's tables: the leaderboard, and tables in the form of the paper's. Cells are text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ..protocol import PCP5
from . import published_numbers as paper
from .labels import name_versions
from .leaderboard import Leaderboard
from .lines import Line
from .statistics import MIN_CLUSTERS, ErrorSummary, best_half
from .suite_scores import SuiteScore, suite_scores

MISSING = "–"
_STARRED = " * With the better of the two signs of each joint: none is known or returned."
_CAPTION = (
    "Error of each scored joint at the last frame: mean over all pairs of sequence and joint, "
    "with its 95 % interval (bootstrap by sequence, or by object where there are several; none for "
    f"fewer than {MIN_CLUSTERS}; of few sequences it is too narrow). The rank is 1 + the number of "
    "rows that paired differences on the same sequences show to be better (sign-flip test, p below "
    "0.05, not corrected for the number of comparisons); rows on other sequences than most have "
    "none. A failed joint counts as no motion. "
    "(best sign): the better of the two signs of each joint, where none is known or returned."
)


@dataclass(frozen=True)
class TableRow:
    """A row of text."""

    cells: tuple[str, ...]
    reference: bool = False
    """Whether the whole row holds the paper's numbers."""


@dataclass(frozen=True)
class Table:
    """A table of unescaped text: each writer escapes it for its format."""

    title: str
    caption: str
    columns: tuple[str, ...]
    align: str
    """One letter a column, as in LaTeX: l, c or r."""
    rows: tuple[TableRow, ...]
    groups: tuple[tuple[str, int], ...] = ()
    """Upper row of the head: text, and the number of columns that it spans."""
    reference: tuple[bool, ...] = ()
    """Whether each column holds the paper's numbers."""


def suite_tables(board: Leaderboard) -> list[Table]:
    """Return a table for each suite: one score of each row over its datasets, best first."""
    scores = suite_scores(board)
    return [_suite_table([s for s in scores if s.suite == suite],
                         len({line.dataset for line in board.lines if _suite(line) == suite}))
            for suite in dict.fromkeys(s.suite for s in scores)]


def _suite_table(scores: Sequence[SuiteScore], number: int) -> Table:
    """Return the table of a suite with results on a number of datasets."""
    suite, of = scores[0].suite, scores[0].of
    title = f"{number} of the {of} datasets" if number < of else "All datasets"
    return Table(
        title + f" of {suite}" * bool(suite),
        "Mean over the datasets of rank and of mean final error, with the 95 % interval of the "
        "error (bootstrap by sequence in each dataset, with equal draws for twins; none where a "
        f"dataset has fewer than {MIN_CLUSTERS} sequences). The error is that of joints that turn; "
        "the rank counts joints that slide as well. Only rows on the same datasets can be "
        "compared. A row whose datasets were measured with several versions of its method names "
        "them. (best sign): the better of the two signs of a joint, on some of the datasets.",
        ("method", "datasets", "mean rank", "mean (deg)", "95 % interval"), "lrrrr",
        tuple(
            TableRow((
                s.label + " (best sign)" * s.best_sign, f"{s.datasets} of {s.of}",
                MISSING if math.isnan(s.mean_rank) else f"{s.mean_rank:.2f}",
                format_error(s.mean), format_interval(s.interval),
            ))
            for s in scores
        ),
    )


def leaderboard_tables(board: Leaderboard) -> list[Table]:
    """Return the leaderboard as one table for each dataset and unit, best first."""
    return [
        Table(
            board.lines[mine[0]].dataset + _say_unit(unit),
            _CAPTION,
            ("rank", "method", "training", "sequences", f"mean ({unit})", "95 % interval", "std",
             "median", "P90", f"PCP@{'5°' if unit == 'deg' else '5 cm'}", "coverage", "s / frame"),
            "rll" + 9 * "r",
            tuple(_leaderboard_row(board, k)
                  for k in sorted(mine, key=lambda k: (
                      not board.ranks[k], board.ranks[k], board.lines[k].summary.mean))
            ),
        )
        for (_, unit), mine in board.groups.items()
    ]


def _leaderboard_row(board: Leaderboard, k: int) -> TableRow:
    line = board.lines[k]
    s, seconds = line.summary, line.means.get("seconds_per_frame")
    label = board.labels[k] + (" (best sign)" if line.best_sign else "")
    return TableRow((
        str(board.ranks[k] or MISSING), label,
        line.row.training, str(s.sequences), format_error(s.mean),
        format_interval((s.ci_low, s.ci_high) if line.has_interval else None),
        format_error(s.std), format_error(s.median), format_error(s.p90),
        format_percent(s.pcp[PCP5]), format_percent(s.coverage),
        MISSING if seconds is None else f"{seconds:.3g}",
    ))


@dataclass(frozen=True)
class _Column:
    """A column of a table: its cells by the label of the row."""

    group: str
    title: str
    cells: dict[str, str]
    reference: bool = False


def paper_tables(board: Leaderboard) -> list[Table]:
    """Return tables by robot and by object for each suite, and by joint for each dataset."""
    lines, labels = board.lines, board.labels
    published = {"deg": board.published}  # no paper has numbers of prismatic joints
    out: list[Table] = []
    for suite in dict.fromkeys(_suite(line) for line in lines):
        here = [k for k, line in enumerate(lines) if _suite(line) == suite]
        named = _mark_signs([lines[k] for k in here], name_versions(
            [lines[k].row for k in here], [labels[k] for k in here]))
        for unit in dict.fromkeys(line.unit for line, _ in named):
            mine = [(x, label) for x, label in named if x.unit == unit]
            arms = [item for item in mine if item[0].robot not in paper.OBJECTS]
            objects = [item for item in mine if item[0].robot in paper.OBJECTS]
            of = (f" of {suite}" if suite else "") + _say_unit(unit)
            kinds = [("Robots", arms, 3), ("Articulated objects", objects, 1)]
            if unit == "m":  # no paper has such a table
                kinds = [("Datasets", mine, 0)]
            for kind, items, number in kinds:
                if items:
                    cells = [p for p in published.get(unit, ()) if p.table == number]
                    out.append(_by_dataset(items, cells, f"{kind}{of}", unit, number))
    named = _mark_signs(lines, labels)
    out += [
        _by_joint([named[k] for k in mine],
                  [p for p in published.get(unit, ()) if p.table == 2])
        for (_, unit), mine in board.groups.items() if len(lines[mine[0]].joints) > 1
    ]
    return out


def _mark_signs(lines: Sequence[Line], labels: Sequence[str]) -> list[tuple[Line, str]]:
    """Return each line with its label, which has a star if it shows the better of two signs."""
    return [(line, label + "*" * line.best_sign)
            for line, label in zip(lines, labels, strict=True)]


def format_error(x: float) -> str:
    """Return a number with three significant digits; with an exponent below 0.0001."""
    if not math.isfinite(x):
        return MISSING
    if x == 0.0:
        return "0"
    decimals = max(0, 2 - math.floor(math.log10(abs(x))))
    return f"{x:.{decimals}f}" if decimals <= 6 else f"{x:.1e}"


def format_interval(interval: tuple[float, float] | None) -> str:
    """As in "0.123 to 0.456"."""
    return MISSING if interval is None else " to ".join(map(format_error, interval))


def _mean_std(summary: ErrorSummary) -> str:
    """As in "0.123 ± 0.045"."""
    return f"{format_error(summary.mean)} ± {format_error(summary.std)}"


def format_percent(x: float) -> str:
    """Return "97.5 %" for 97.5."""
    return f"{x:.1f} %"


def _by_dataset(
    named: Sequence[tuple[Line, str]], published: Sequence[paper.PublishedCell], title: str,
    unit: str, number: int,
) -> Table:
    columns: list[_Column] = []
    for dataset in dict.fromkeys(line.dataset for line, _ in named):
        mine = [(line, label) for line, label in named if line.dataset == dataset]
        head = dataset.rpartition("/")[2]
        cells = {label: _mean_std(line.summary) for line, label in mine}
        columns.append(_Column(head, "mean ± std", cells))
        cells = {label: format_percent(line.summary.pcp[PCP5]) for line, label in mine}
        columns.append(_Column(head, f"PCP@5{'°' if unit == 'deg' else ' cm'}", cells))
        if mine[0][0].robot == paper.OWI:  # the metric that CRAVES publishes
            cells = {label: format_error(best_half([*x.error.values()])) for x, label in mine}
            columns.append(_Column(head, "best half", cells))
        cells_of = [p for p in published if p.robot == mine[0][0].robot]
        columns += _reference(mine, cells_of, head)
    limit = "5°" if unit == "deg" else "5 cm"
    form = f"In the form of table {number} of the GC-Pose paper. " if number else ""
    caption = f"{form}Error at the last frame in {unit}, mean and standard deviation over all " \
              f"pairs of sequence and joint, and the share of pairs within {limit}."
    return _table(title, caption, columns, _order_labels(named))


def _by_joint(named: Sequence[tuple[Line, str]], published: Sequence[paper.PublishedCell]) -> Table:
    first = named[0][0]
    columns: list[_Column] = []
    joints = dict.fromkeys((joint.index, joint.name) for line, _ in named for joint in line.joints)
    for index, name in sorted(joints):
        cells = {
            label: _mean_std(joint.summary)
            for line, label in named for joint in line.joints if joint.name == name
        }
        columns.append(_Column(name, "mean ± std", cells))
        cells_of = [p for p in published if (p.robot, p.joint) == (first.robot, index)]
        columns += _reference(named, cells_of, name)
    real = [p for p in published if (p.robot, p.joint) == (first.robot, 0)]
    columns += _reference(named, real, "real images, all joints")
    form = "In the form of table 2 of the GC-Pose paper. " if first.robot == paper.OWI else ""
    caption = f"{form}Error of each joint at the last frame in {first.unit}, mean and standard " \
              "deviation."
    title = f"Joints of {first.dataset}{_say_unit(first.unit)}"
    return _table(title, caption, columns, _order_labels(named))


def _reference(
    named: Iterable[tuple[Line, str]], published: Sequence[paper.PublishedCell], head: str
) -> list[_Column]:
    """The papers' column of a robot: in the rows of our counterparts, or in rows of its own."""
    printed = {p.method: p for p in published}
    if not printed:
        return []
    cells = {f"{name} (paper)": _print_cell(p) for name, p in printed.items()}
    for line, label in named:
        other = paper.counterpart(line.row, published[0].table, line.robot)
        if other in printed:
            cells[label] = cells.pop(f"{other} (paper)", _print_cell(printed[other]))
    return [_Column(head, "paper", cells, reference=True)]


def _print_cell(p: paper.PublishedCell) -> str:
    text = f"{p.mean:.2f}"
    if p.std is not None:
        text += f" ± {p.std:.2f}"
    return text if p.pcp5 is None else f"{text}, {p.pcp5:.1f} %"


def _order_labels(named: Iterable[tuple[Line, str]]) -> list[str]:
    """Labels of our rows, by increasing mean error over the datasets."""
    means: dict[str, list[float]] = {}
    for line, label in named:
        means.setdefault(label, []).append(line.summary.mean)
    return sorted(means, key=lambda label: (sum(means[label]) / len(means[label]), label))


def _table(title: str, caption: str, columns: Sequence[_Column], ours: Sequence[str]) -> Table:
    theirs = [
        name for name in dict.fromkeys(n for c in columns for n in c.cells) if name not in ours
    ]
    groups: list[tuple[str, int]] = [("", 1)]
    for column in columns:
        if len(groups) > 1 and groups[-1][0] == column.group:
            groups[-1] = (column.group, groups[-1][1] + 1)
        else:
            groups.append((column.group, 1))
    return Table(
        title,
        caption + (_STARRED if any(label.endswith("*") for label in ours) else ""),
        ("method", *(column.title for column in columns)),
        "l" + len(columns) * "c",
        tuple(
            TableRow((name, *(c.cells.get(name, MISSING) for c in columns)), name in theirs)
            for name in (*ours, *theirs)
        ),
        tuple(groups),
        (False, *(column.reference for column in columns)),
    )


def _say_unit(unit: str) -> str:
    """Return what the title of a table says about its joints."""
    return " (prismatic joints)" * (unit == "m")


def _suite(line: Line) -> str:
    return line.dataset.rpartition("/")[0]
