"""The leaderboard: all lines, compared on the same sequences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...errors import ConfigError, DatasetError
from ...renderer.scene import differences as config_differences
from ..results import SCORES, Row, RunFolder, find_runs, is_label
from . import published_numbers as paper
from .copies import dataset_title, have_equal_motions, without_copies
from .labels import label_rows
from .lines import Line, lines_of, name_count
from .published_rows import published_lines
from .statistics import MIN_CLUSTERS, Difference, compare_rows, shared_ranks


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
    a line on other sequences than most of its group."""
    repeated: frozenset[int]
    """Positions of published lines whose method is also among the user's ranked rows of the group:
    they have a rank, and do not count in the ranks of others."""
    unfinished: tuple[RunFolder, ...]
    """Runs without final errors: stopped, or still running, or with a table that lacks them."""
    published: tuple[paper.PublishedCell, ...] = paper.PUBLISHED
    """Numbers of papers, which stand beside the lines and are not ranked."""

    @property
    def groups(self) -> dict[tuple[str, str], list[int]]:
        """Positions of the lines of each group."""
        out: dict[tuple[str, str], list[int]] = {}
        for k, line in enumerate(self.lines):
            out.setdefault(line.group, []).append(k)
        return out

    @property
    def robots_without_results(self) -> list[str]:
        """Robots of the numbers of papers that were given, on which there are no results."""
        given = {cell.robot for cell in self.published if cell not in paper.PUBLISHED}
        return sorted(given - {line.robot for line in self.lines})

    def describe_unfinished(self) -> list[str]:
        """Return a line for each run without scores."""
        return [f"{f.run.row.title} on {dataset_title(f.run)}: {count_estimates(f)}"
                for f in self.unfinished]

    def describe_unranked(self) -> list[str]:
        """Return a line for each row of the user that has no rank."""
        return [f"{label} on {line.dataset}: it is on other sequences than most rows, or lacks some"
                for line, label, rank in zip(self.lines, self.labels, self.ranks, strict=True)
                if not (rank or line.published)]

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
    results: Sequence[Path], labels: Sequence[str] = (), published: Path | None = None
) -> Leaderboard:
    """Read and compare all results under the folders; labels are NAME=FOLDER.

    A CSV file in place of a folder holds numbers of papers (`published_numbers.read_published`).
    `published` is a folder of published rows, see `build_leaderboard`.

    Raises:
        ConfigError: If a label is not of this form, or a file is a table of scores.
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
    if scores := [path for path in files if path.name == SCORES]:
        raise ConfigError(f"{scores[0]} is a table of scores; give its results folder, as in "
                          "`gcbench report results`")
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
    folders: Iterable[RunFolder], published: Path | None = None
) -> Leaderboard:
    """Summarize and compare runs, and the published rows of a folder beside them.

    Published rows are scored on the same sequences as most of the runs, if they have them; of those
    of equally many runs, on what the most published rows have. Those on
    other datasets than the runs, or on other motions, are left out; without runs, all are shown.
    Raises DatasetError as `read_leaderboard` does, and if a published file is damaged.
    """
    folders = list(folders)
    scored = without_copies(f for f in folders if (f.path / SCORES).exists())
    lines_by_run = [_mark_partial(lines_of(folder, folder.scores())) for folder in scored]
    lines = [line for mine in lines_by_run for line in mine]
    first: dict[tuple[str, str], Line] = {}
    for line in lines:
        like = first.setdefault(line.group, line)
        if not _have_equal_motions(like, line):
            raise DatasetError(
                f"{like.run.path} and {line.run.path} are on two datasets of one name (their "
                "motions differ); report them separately")
    if published is not None:
        usual = {dataset: _most_frequent([line for line in lines if line.dataset == dataset])
                 for dataset in {line.dataset for line in lines}}
        lines += [line for line in published_lines(published, usual) if not first or (
            (like := first.get(line.group)) and _have_equal_motions(like, line)
            and not config_differences(like.run.run.config, line.run.run.config))]
    lines.sort(key=lambda line: (
        line.dataset.rpartition("/")[0], paper.paper_order(line.robot), *line.group,
        line.summary.mean, line.row.folder, line.published,
    ))  # fmt: skip
    empty = [f for f, mine in zip(scored, lines_by_run, strict=True) if not mine]
    unfinished = (*(f for f in folders if not (f.path / SCORES).exists()), *empty)
    differences: dict[tuple[int, int], Difference] = {}
    board = Leaderboard(tuple(lines), differences, (), frozenset(), unfinished)
    ranked: set[int] = set()
    repeated: set[int] = set()
    for mine in board.groups.values():
        usual_here = _usual_sequences([lines[k] for k in mine])
        mine = [k for k in mine if _is_whole(lines[k]) and lines[k].sequences == usual_here]
        ranked |= {*mine}
        repeated |= _find_repeated(lines, mine)
        found = compare_rows([(lines[k].error, lines[k].cluster) for k in mine])
        differences |= {(mine[a], mine[b]): d for (a, b), d in found.items()}
    ranks = shared_ranks(len(lines), differences, repeated)
    return replace(board, lines=_name_extents(lines, ranked), repeated=frozenset(repeated),
                   ranks=tuple(r * (k in ranked) for k, r in enumerate(ranks)))


def _have_equal_motions(one: Line, other: Line) -> bool:
    return have_equal_motions(one.conditions["displacement"], other.conditions["displacement"])


def _find_repeated(lines: Sequence[Line], positions: Sequence[int]) -> set[int]:
    """Return which of these lines are published rows of a method that the user has measured too."""
    def method(k: int) -> Row:
        return replace(lines[k].row, training="")

    own = {method(k) for k in positions if not lines[k].published}
    return {k for k in positions if lines[k].published and method(k) in own}


def _is_whole(line: Line) -> bool:
    """Whether all sequences of a line have scores."""
    return bool(line.published) or not line.extent


def _most_frequent(lines: Sequence[Line]) -> list[frozenset[str]]:
    """Return the sequences of most lines of one dataset: of the user's own, if there are any. Those
    of equally many lines are all returned, the most sequences first.

    Those that do not suffice for an interval count only if all are such.
    """
    whole = [line for line in lines if _is_whole(line)]
    own = [line for line in whole if not line.published]
    number = Counter(line.sequences for line in own or whole)
    order = {names: (len(names) >= MIN_CLUSTERS, count) for names, count in number.items()}
    return sorted((names for names in order if order[names] == max(order.values())),
                  key=lambda names: (len(names), sorted(names)), reverse=True)


def _usual_sequences(lines: Sequence[Line]) -> frozenset[str]:
    """Return the first of the most frequent sequences that the most published lines have."""
    published = Counter(line.sequences for line in lines if line.published)
    return max(_most_frequent(lines), default=frozenset[str](), key=lambda names: published[names])


def _mark_partial(lines: Sequence[Line]) -> list[Line]:
    """The lines of one run; if sequences have no scores, with their `extent`."""
    scored = {name for line in lines for name in line.sequences}
    return [line if scored >= {*line.run.run.sequences} else
            replace(line, extent=f"{len(scored)} of {len(line.run.run.sequences)} sequences")
            for line in lines]


def _name_extents(lines: Sequence[Line], ranked: set[int]) -> tuple[Line, ...]:
    """Return the lines; the user's rows with a line on other sequences than most say how many they
    have, on all datasets of a suite. Published lines, and those that lack scores, say it already.
    """
    def key(line: Line) -> tuple[Row, str]:
        return line.row, line.dataset.rpartition("/")[0]

    own = [k for k, line in enumerate(lines) if not line.extent]
    counts: dict[tuple[Row, str], set[int]] = {}
    for k in own:
        counts.setdefault(key(lines[k]), set()).add(len(lines[k].sequences))
    other = {key(lines[k]) for k in own if k not in ranked}
    return tuple(
        replace(line, extent=name_count(counts[key(line)]))
        if key(line) in other and not line.extent else line for line in lines)


def _add_label(folder: RunFolder, label: str) -> RunFolder:
    """Add a label to the name of the method."""
    row = folder.run.row
    if not label:
        return folder
    row = replace(row, method=f"{row.method} ({label})")
    return replace(folder, run=replace(folder.run, row=row))
