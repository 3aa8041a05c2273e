"""Where the numbers of a report come from: protocol, methods, datasets, limits and machines."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from ... import __version__
from ..results import Run
from .copies import dataset_title
from .formats import one_line
from .lines import Line
from .statistics import DRAWS, SEED

Section = tuple[str, list[tuple[str, str]]]
"""Title, and rows of name and text."""
_PROTOCOL = [
    ("error", "|wrap(sign × estimate − truth)| of each scored joint at the last frame; without "
              "wrap for prismatic joints"),
    ("mean", "over all pairs of sequence and joint; standard deviation over the same pairs"),
    ("PCP@5", "share of pairs within 5° (prismatic: 5 cm)"),
    ("missing", "counts as no motion, and as wrong for PCP; no mean omits a pair"),
    ("interval", f"95 %, percentile bootstrap of {DRAWS} draws of whole sequences (object "
                 f"instances, where there are several), seed {SEED}"),
    ("ranks", "1 + the number of rows whose paired difference is better beyond its interval; no "
              "correction for the number of comparisons"),
    ("the paper's data", "are not published: its numbers are a reference and are not ranked"),
]
_CONFIG = ("robot", "seed", "stream", "frames", "width", "height", "keep_unobservable")


def provenance(lines: Sequence[Line]) -> list[Section]:
    """Return the sections of a report about the origin of its numbers, without doubles."""
    lines = sorted(lines, key=lambda line: bool(line.published))  # own folders are named first
    runs = list({str(line.run.path): line.run.run for line in lines}.values())
    methods = {_method(run) for run in runs}
    datasets = {dataset_title(run): [*_dataset(run)] for run in reversed(runs)}
    machines = sorted({tuple(_flatten(e)) for run in runs for e in run.environments})
    sections: list[tuple[str, Iterable[tuple[str, str]]]] = [
        ("Protocol", _PROTOCOL),
        ("Methods", sorted(methods)),
        *((f"Dataset {title}", datasets[title]) for title in sorted(datasets)),
        ("Limits", sorted(_limits(runs))),
        *((f"Machine {k}" if len(machines) > 1 else "Machine", rows)
          for k, rows in enumerate(machines, 1)),
        ("Report", [("written by", f"gcbench {__version__}")]),
    ]
    return [
        (one_line(title), [(one_line(key), one_line(text)) for key, text in rows])
        for title, rows in sections
    ]


def _method(run: Run) -> tuple[str, str]:
    row = run.row
    oracles = f"; oracles: {', '.join(row.oracles)}" if row.oracles else ""
    by = run.attribution
    made = "".join(f"; {text}" for text in (by.authors, by.date, by.link) if text)
    return row.name, f"version {row.version}; training: {row.training}; {run.source}{oracles}{made}"


def _dataset(run: Run) -> Iterator[tuple[str, str]]:
    yield "folder", run.data or "none: published rows"
    yield "sequences", str(len(run.sequences))
    if run.left_out:
        yield "left out", f"{run.left_out}, unobservable or without a scored joint"
    yield from ((key, _words(run.config[key])) for key in _CONFIG if key in run.config)
    for asset in run.assets:
        source = f"{asset.get('source', '')}; {asset.get('licence', '')}"
        yield f"model {asset.get('name', '')}", source.strip("; ")


def _limits(runs: Sequence[Run]) -> Iterator[tuple[str, str]]:
    """Yield each limit; with its rows, if they had different ones."""
    rows: dict[str, dict[str, list[str]]] = {}
    for run in runs:
        for key, value in run.limits.items():
            rows.setdefault(key, {}).setdefault(_words(value), []).append(run.row.title)
    for key, values in rows.items():
        for value, titles in values.items():
            who = f": {', '.join(dict.fromkeys(titles))}" if len(values) > 1 else ""
            yield key, f"{value}{who}"


def _flatten(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, "" if key == "dependencies" else f"{prefix}{key} ")
        else:
            yield f"{prefix}{key}", _words(value)


def _words(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(str(x) for x in value)
    return str(value)
