"""What a report says about how its numbers came to be, and about what failed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ... import __version__
from ...errors import GcbenchError
from ..results import RunFolder, Shape, read_stored
from .formats import one_line
from .leaderboard import Board, Line
from .standings import SEED
from .statistics import DRAWS

MAX_REASON = 400
"""Characters of a reason that are shown: its end, where the error stands."""
_ANY = Shape(frames=1, joints=1, height=1, width=1)
Section = tuple[str, list[tuple[str, str]]]
Failure = tuple[str, str, str, str, str]
"""Row, dataset, sequence, status, reason."""


def about(lines: Sequence[Line]) -> list[Section]:
    """Title and rows of each section."""
    folders = list({str(line.run.path): line.run for line in lines}.values())
    return [
        _protocol(),
        *_methods(folders),
        *_datasets(folders),
        *_limits(folders),
        *_environments(folders),
    ]


def failures(board: Board) -> list[Failure]:
    """Each sequence that a method failed on or that is not scored, and each unfinished run."""
    out: list[Failure] = []
    for folder in board.unfinished:
        run = folder.run
        done = sum(folder.estimate_path(name).exists() for name in run.sequences)
        out.append((one_line(run.row.title), one_line(run.dataset), "", "unfinished",
                    f"{done} of {len(run.sequences)} sequences estimated and none scored; the same "
                    "gcbench eval continues it"))  # fmt: skip
    for folder in {str(line.run.path): line.run for line in board.lines}.values():
        mine = [line for line in board.lines if line.run.path == folder.path]
        bad = {name: status for line in mine for name, status in line.failed.items()}
        scored = {name for line in mine for name, _ in line.error}
        bad |= {name: "not scored" for name in folder.run.sequences if name not in scored}
        row, dataset = one_line(folder.run.row.title), one_line(folder.run.dataset)
        out += [(row, dataset, name, bad[name], _reason(folder, name)) for name in sorted(bad)]
    return out


def _reason(folder: RunFolder, name: str) -> str:
    try:
        stored = read_stored(folder.estimate_path(name), _ANY)
    except GcbenchError as error:
        return one_line(str(error))
    reason = one_line(stored.reason)
    return reason if len(reason) <= MAX_REASON else "…" + reason[-MAX_REASON:]


def _protocol() -> Section:
    return "Protocol", [
        ("error", "|wrap(sign × estimate − truth)| of each scored joint at the last frame; "
                  "without wrap for prismatic joints"),
        ("mean", "over all pairs of sequence and joint; standard deviation over the same pairs"),
        ("PCP@5", "share of pairs within 5° (prismatic: 5 cm)"),
        ("missing", "counts as no motion, and as wrong for PCP; nothing is left out of a mean"),
        ("interval", f"95 %, percentile bootstrap of {DRAWS} draws of whole sequences (object "
                     f"instances, where there are several), seed {SEED}"),
        ("ranks", "1 + the number of rows whose paired difference is better beyond its interval; "
                  "no correction for the number of comparisons"),
        ("the paper's data", "are not published: its numbers are a reference, never ranked"),
    ]  # fmt: skip


def _methods(folders: Iterable[RunFolder]) -> list[Section]:
    rows: dict[str, tuple[str, str]] = {}
    for folder in folders:
        row = folder.run.row
        oracles = f"; ORACLE, was given: {', '.join(row.oracles)}" if row.oracles else ""
        words = f"version {row.version}; training: {row.training}; {folder.run.source}{oracles}"
        rows.setdefault(f"{row.name} {words}", (one_line(row.name), one_line(words)))
    return [("Methods", [rows[key] for key in sorted(rows)])]


def _datasets(folders: Iterable[RunFolder]) -> list[Section]:
    out: dict[str, Section] = {}
    for folder in folders:
        run = folder.run
        config = run.config
        rows = [("folder", run.data), ("sequences", str(len(run.sequences)))]
        if run.left_out:
            rows.append(("left out", f"{run.left_out}, unobservable or without a scored joint"))
        rows += [(key, _words(config[key])) for key in
                 ("robot", "seed", "stream", "frames", "width", "height", "keep_unobservable")
                 if key in config]  # fmt: skip
        for asset in run.assets:
            source, licence = str(asset.get("source", "")), str(asset.get("licence", ""))
            rows.append((f"model {asset.get('name', '')}", f"{source}; {licence}".strip("; ")))
        out.setdefault(run.dataset, (f"Dataset {one_line(run.dataset)}", _clean(rows)))
    return [out[key] for key in sorted(out)]


def _limits(folders: Iterable[RunFolder]) -> list[Section]:
    rows: dict[tuple[str, str], list[str]] = {}
    for folder in folders:
        for key, value in folder.run.limits.items():
            rows.setdefault((str(key), _words(value)), []).append(folder.run.row.title)
    keys = [key for key, _ in rows]
    found = [
        (key, value if keys.count(key) == 1 else f"{value}: {', '.join(dict.fromkeys(titles))}")
        for (key, value), titles in rows.items()
    ]
    return [("Limits", _clean(sorted(found)))] if found else []


def _environments(folders: Iterable[RunFolder]) -> list[Section]:
    """Each machine or installation once."""
    found: dict[str, list[tuple[str, str]]] = {}
    for folder in folders:
        for environment in folder.run.environments:
            rows = _clean(_flat(environment))
            found.setdefault(repr(rows), rows)
    sections = [found[key] for key in sorted(found)]
    several = len(sections) > 1
    titles = [f"Machine {k}" if several else "Machine" for k in range(1, len(sections) + 1)]
    this = ("Report", [("written by", f"gcbench {__version__}")])
    return [*zip(titles, sections, strict=True), this]


def _flat(tree: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    out: list[tuple[str, str]] = []
    for key, value in tree.items():
        if isinstance(value, Mapping):
            inner = "" if key == "dependencies" else f"{prefix}{key} "
            out += _flat(value, inner)
        else:
            out.append((f"{prefix}{key}", _words(value)))
    return out


def _words(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(str(x) for x in value)
    return str(value)


def _clean(rows: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    return [(one_line(key), one_line(text)) for key, text in rows]
