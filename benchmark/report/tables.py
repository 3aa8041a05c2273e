"""Tables in the form of the paper's: by robot, by object category, by joint. Cells are text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from . import published_numbers as paper
from .leaderboard import PCP5, Line, labels_of
from .statistics import Summary, best_half

NONE = "–"
STARRED = " * With the better of the two signs of each joint: none is known or returned."


@dataclass(frozen=True)
class TableRow:
    """A row of text; the first cell names it."""

    cells: tuple[str, ...]
    reference: bool = False
    """All of it is the paper's."""


@dataclass(frozen=True)
class Table:
    """A table with a head of two rows. Text is as it came: whoever writes it down escapes it."""

    title: str
    caption: str
    groups: tuple[tuple[str, int], ...]
    """(text, how many columns it spans)"""
    columns: tuple[str, ...]
    reference: tuple[bool, ...]
    """Of each column: whether it holds the paper's numbers."""
    rows: tuple[TableRow, ...]


@dataclass(frozen=True)
class _Column:
    """A column of a table: its cells by the row's name."""

    group: str
    title: str
    cells: dict[str, str]
    reference: bool = False


def paper_tables(lines: Sequence[Line]) -> list[Table]:
    """Every table of a board: by robot and by object for each suite, by joint for each dataset."""
    named = [(line, label + ("*" if "best" in line.sign else ""))
             for line, label in zip(lines, labels_of(lines), strict=True)]  # fmt: skip
    out: list[Table] = []
    for suite in dict.fromkeys(_suite(line) for line in lines):
        for unit in dict.fromkeys(line.unit for line in lines if _suite(line) == suite):
            mine = [(x, label) for x, label in named if _suite(x) == suite and x.unit == unit]
            arms = [item for item in mine if item[0].robot not in paper.OBJECTS]
            objects = [item for item in mine if item[0].robot in paper.OBJECTS]
            of = f" of {suite}" if suite else ""
            if arms:
                out.append(_by_dataset(arms, 3, f"Robots{of}", unit))
            if objects:
                out.append(_by_dataset(objects, 1, f"Articulated objects{of}", unit))
    for group in dict.fromkeys(line.group for line in lines):
        mine = [item for item in named if item[0].group == group]
        if len(mine[0][0].joints) > 1:
            out.append(_by_joint(mine))
    return out


def value(x: float, unit: str) -> str:
    """A number in a unit's usual digits, without the unit: 3 for deg, 4 for m."""
    return f"{x:.{4 if unit == 'm' else 3}f}"


def mean_std(summary: Summary, unit: str) -> str:
    """ "0.123 ± 0.045" """
    return f"{value(summary.mean, unit)} ± {value(summary.std, unit)}"


def percent(x: float) -> str:
    """ "97.5 %" of 97.5"""
    return f"{x:.1f} %"


def _by_dataset(named: Sequence[tuple[Line, str]], table: int, title: str, unit: str) -> Table:
    columns: list[_Column] = []
    for dataset in dict.fromkeys(line.dataset for line, _ in named):
        mine = [(line, label) for line, label in named if line.dataset == dataset]
        head = dataset.rpartition("/")[2]
        cells = {label: mean_std(line.summary, unit) for line, label in mine}
        columns.append(_Column(head, "mean ± std", cells))
        cells = {label: percent(line.summary.pcp[PCP5]) for line, label in mine}
        columns.append(_Column(head, f"PCP@5{'°' if unit == 'deg' else ' cm'}", cells))
        if mine[0][0].robot == paper.OWI:  # as CRAVES publishes it
            cells = {label: value(best_half([*x.error.values()]), unit) for x, label in mine}
            columns.append(_Column(head, "best half", cells))
        columns += _reference(mine, table, mine[0][0].robot, 0, head)
    limit = "5°" if unit == "deg" else "5 cm"
    caption = f"Error at the last frame in {unit}, mean and standard deviation over all pairs of " \
              f"sequence and joint, and the share of pairs within {limit}."  # fmt: skip
    return _table(title, caption, columns, _ordered(named))


def _by_joint(named: Sequence[tuple[Line, str]]) -> Table:
    first = named[0][0]
    columns: list[_Column] = []
    joints = dict.fromkeys((joint.index, joint.name) for line, _ in named for joint in line.joints)
    for index, name in sorted(joints):
        cells = {
            label: mean_std(joint.summary, line.unit)
            for line, label in named for joint in line.joints if joint.name == name
        }  # fmt: skip
        columns.append(_Column(name, "mean ± std", cells))
        columns += _reference(named, 2, first.robot, index, name)
    caption = f"Error of each joint at the last frame in {first.unit}, mean and standard deviation."
    return _table(f"Joints of {first.dataset}", caption, columns, _ordered(named))


def _reference(
    named: Iterable[tuple[Line, str]], table: int, robot: str, joint: int, head: str
) -> list[_Column]:
    """The paper's column of a robot: beside our counterparts, and in rows of its own."""
    printed = {p.method: p for p in paper.printed(table, robot) if p.joint == joint}
    if not printed:
        return []
    cells = {f"{name} (paper)": _printed(p) for name, p in printed.items()}
    for line, label in named:
        other = paper.counterpart(line.row, table)
        if other in printed:
            cells[label] = cells.pop(f"{other} (paper)", _printed(printed[other]))
    return [_Column(head, "paper", cells, reference=True)]


def _printed(p: paper.Printed) -> str:
    text = f"{p.mean:.2f}"
    if p.std is not None:
        text += f" ± {p.std:.2f}"
    return text if p.pcp5 is None else f"{text}, {p.pcp5:.1f} %"


def _ordered(named: Iterable[tuple[Line, str]]) -> list[str]:
    """Our rows, those with the smallest error on average first."""
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
        caption + (STARRED if any(label.endswith("*") for label in ours) else ""),
        tuple(groups),
        ("method", *(column.title for column in columns)),
        (False, *(column.reference for column in columns)),
        tuple(
            TableRow((name, *(column.cells.get(name, NONE) for column in columns)), name in theirs)
            for name in (*ours, *theirs)
        ),
    )


def _suite(line: Line) -> str:
    return line.dataset.rpartition("/")[0]
