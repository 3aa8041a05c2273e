"""The commands `gcbench eval`, `score`, `report`, `methods` and `suites`."""

import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .results import Results


def evaluate(args: Sequence[str]) -> tuple[object, int]:
    """Run methods on datasets and score them.

    To continue an interrupted run, run the same command again. Each method runs in a separate
    process with a time limit. If it raises, hangs, crashes or returns an invalid estimate, that
    sequence is scored as no motion. At the end, a page of these results is written to
    RESULTS/report. The exit code is 1 if no estimate succeeded.

    Examples:
      gcbench eval --method gcpose
      gcbench eval --method icp icp@true-parts hold-still --data data/ur5 --inputs rgbd
      gcbench eval --method my_method.py:MyMethod --suite my_suite.toml --knowledge free
      gcbench eval --method gcpose --set rgbd.candidates=800 --data data/ur5 --limit 5
    """
    from .. import EvalConfig, report
    from .. import evaluate as run_evaluation
    from ..renderer.runtime import command_line

    options = command_line.parse_options(args, "eval", EvalConfig, evaluate.__doc__)
    results = run_evaluation(options)
    text, code = _describe(results)
    if results.usable:
        text += f"\n{report(results, options.results / 'report', False, False)[0]}"
    return text, code


def score(args: Sequence[str]) -> tuple[object, int]:
    """Score the predictions of a method that ran elsewhere."""
    from ..renderer.runtime import command_line
    from .run import ScoreConfig, score_predictions

    options = command_line.parse_options(args, "score", ScoreConfig, ScoreConfig.__doc__)
    results = score_predictions(options)
    return (str(options.predictions), 0) if options.template else _describe(results)


def _describe(results: "Results") -> tuple[str, int]:
    """Return the leaderboard, the failures and the folders as text, and the exit code."""
    from .report import leaderboard_text

    lines = [leaderboard_text(results.runs), *(f"failed: {line}" for line in results.failures),
             *dict.fromkeys(str(folder.path) for folder in results.runs)]
    if not results.usable:
        print("gcbench: no sequence was estimated", file=sys.stderr)
    return "\n".join(lines), 0 if results.usable else 1


def report(
    results: tuple[Path, ...] = (Path("results"),), /, out: Path = Path("report"),
    pictures: bool = True, label: tuple[str, ...] = (), allow_model: bool = False,
    open: bool = False,
) -> tuple[object, int]:
    """Write a leaderboard: a page, CSV, Markdown and LaTeX.

    Methods that do not differ significantly share a rank.

    Examples:
      gcbench report
      gcbench report results others/results --label others=others/results --open
      gcbench report results --out report --no-pictures

    Args:
        results: Folders that `gcbench eval` and `gcbench score` wrote.
        out: Folder of the report.
        pictures: Draw the worst and the median sequence of each row (needs a renderer).
        label: NAME=FOLDER adds NAME to the methods of a results folder.
        allow_model: Read models from paths that the datasets name, or download them.
        open: Open the page in the browser.
    """
    from .. import report as write_report

    written = write_report(results, out, pictures, labels=label, allow_model=allow_model)
    if open:
        webbrowser.open(written[0].resolve().as_uri())
    return "\n".join(map(str, written)), 0


def methods() -> tuple[object, int]:
    """List the methods that `gcbench eval` knows by name.

    Example:
      gcbench methods
    """
    from .methods import methods_table

    return methods_table(), 0


def suites() -> tuple[object, int]:
    """List the suites of datasets that `gcbench eval` knows by name.

    Example:
      gcbench suites
    """
    from .run import suites_table

    return suites_table(), 0
