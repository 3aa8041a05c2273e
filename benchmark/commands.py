"""The commands `gcbench eval`, `score`, `report`, `publish`, `methods` and `suites`."""

import sys
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ConfigError

if TYPE_CHECKING:
    from .results import Results

_GROUPS = {
    "options": "--help --method --suite --datasets --data --inputs --knowledge --limit --shard "
               "--workers --results --quiet --json",
    "method": "--set --flow --depth --foreground --weights",
    "cluster": "--executor --address --gpus",
    "limit": "--timeout --memory --retry --python",
    "data": "--suites --keep-unobservable --allow-model",
}
"""Options of `gcbench eval` by group."""


def evaluate(args: Sequence[str]) -> tuple[object, int]:
    """Run methods on datasets and score them.

    To continue an interrupted run, run the same command again. Each method runs in a separate
    process with a time limit. If it raises, hangs, crashes or returns an invalid estimate, that
    sequence is scored as no motion. At the end, a page of these results is written to
    RESULTS/report (not by a shard). The exit code is 1 if no estimate succeeded, or a method could
    not be run to its end.

    Examples:
      gcbench eval --method gcpose
      gcbench eval --method icp icp@true-parts hold-still --data data/ur5 --inputs rgbd
      gcbench eval --method my_method.py:MyMethod --suite my_suite.toml --knowledge free
      gcbench eval --method abbatematteo --weights oven --suite standard --datasets oven
      gcbench eval --method gcpose --set rgbd.candidates=800 --data data/ur5 --limit 5
      gcbench eval --method gcpose --data /shared/ur5 --results /shared/results --shard 3/64
    """
    from .. import EvalConfig, report
    from .. import evaluate as run_evaluation
    from ..renderer.runtime import command_line

    @dataclass(frozen=True)
    class Options(command_line.OutputOptions, EvalConfig):
        pass

    options = command_line.parse_options(args, "eval", Options, evaluate.__doc__, None, _GROUPS)
    results = run_evaluation(options, not options.quiet)
    pages: list[Path] = []
    if results.usable and not options.shard:  # all shards would write the same page
        pages = report(results, Path(options.results, "report"), False, False)[:1]
    return _describe(results, pages, options.json)


def score(args: Sequence[str]) -> tuple[object, int]:
    """Score the predictions of a method that ran elsewhere."""
    from ..renderer.runtime import command_line
    from .run import ScoreConfig, score_predictions

    @dataclass(frozen=True)
    class Options(command_line.OutputOptions, ScoreConfig):
        pass

    options = command_line.parse_options(args, "score", Options, ScoreConfig.__doc__)
    results = score_predictions(options, not options.quiet)
    if options.template:
        return {"template": options.predictions} if options.json else options.predictions, 0
    return _describe(results, [], options.json)


def _describe(results: "Results", pages: Sequence[Path], json: bool) -> tuple[object, int]:
    """Return the leaderboard, the failures, the folders and the pages, and the exit code."""
    from .report import build_leaderboard, leaderboard_records, leaderboard_text

    board = build_leaderboard(results.runs)
    folders = [*dict.fromkeys(folder.path for folder in results.runs)]
    code = 0 if results.usable or not results.failures else 1  # a shard may have no sequences
    if code:
        print("gcbench: no sequence was estimated", file=sys.stderr)
    code = 1 if results.ended_early else code
    if json:
        return {
            "leaderboard": leaderboard_records(board), "estimated": results.estimated,
            "usable": results.usable, "failures": results.failures,
            "unfinished": results.unfinished, "folders": folders, "pages": pages,
        }, code  # fmt: skip
    notes = [f"failed: {line}" for line in results.failures]
    notes += [f"unfinished: {line}" for line in results.unfinished]
    text = [leaderboard_text(board)] * bool(board.lines)
    return "\n".join(map(str, [*text, *notes, *folders, *pages])), code


def report(
    results: tuple[Path, ...] = (Path("results"),), /, out: Path = Path("report"),
    pictures: bool = True, label: tuple[str, ...] = (), allow_model: bool = False,
    published: str = "", open: bool = False, quiet: bool = False, json: bool = False,
) -> tuple[object, int]:
    """Write a leaderboard: a page, CSV, Markdown and LaTeX.

    The rank is 1 + the number of rows that are significantly better on the same sequences. On a
    dataset of the suite `standard`, published rows stand beside yours, scored on your sequences if
    they have them.

    Examples:
      gcbench report
      gcbench report results others/results --label others=others/results --open
      gcbench report results papers.csv          # columns method, robot, mean; std, pcp5, joint
      gcbench report results --out report --no-pictures
      gcbench report results --published none

    Args:
        results: Folders that `gcbench eval` and `gcbench score` wrote, and CSV files with numbers
            of papers, which are shown and not ranked.
        out: Folder of the report.
        pictures: Leave out the pictures of the worst and the median sequence of each row, which
            need a renderer.
        label: NAME=FOLDER adds NAME to the methods of a results folder.
        allow_model: Read models from paths that the datasets name, or download them.
        published: Folder of published rows; none hides them. Default: those of this package.
        open: Open the page in the browser.
        quiet: Show no progress: print the result and errors only.
        json: Print the names of the files as one JSON document.
    """
    from .. import ReportOptions
    from .. import report as write_report
    from .report import PUBLISHED_ROWS

    beside = None if published == "none" else Path(published or PUBLISHED_ROWS)
    written = write_report(
        results, out, pictures, not quiet, ReportOptions(label, beside, allow_model))
    if open:
        webbrowser.open(written[0].resolve().as_uri())
    named = dict(zip(("page", "markdown", "csv", "latex", "tables"), written, strict=True))
    return named if json else "\n".join(map(str, written)), 0


def publish(
    results: tuple[Path, ...] = (), /, to: Path | None = None, check: bool = False,
    draw: int | None = None, rescore: bool = False, json: bool = False,
) -> tuple[object, int]:
    """Store estimates on a suite and their scores in compact form, for the published leaderboard.

    Sequences are added to a published row of the same version of the method; a row of another
    version is replaced. Without --to, the files of this installation are changed: use a checkout,
    and commit them. With --check, nothing is written: the scores of all published rows are computed
    again from their estimates, and the truth of a few sequences of each dataset is drawn again. The
    exit code is 1 if one differs. With --rescore, the scores of all published rows are computed
    again and stored.

    Examples:
      gcbench publish results
      gcbench publish --check

    Args:
        results: Folders that `gcbench eval` and `gcbench score` wrote. Default: results.
        to: Folder of published rows. Default: those of this package.
        check: Check the published rows.
        draw: Number of sequences of each dataset whose truth --check draws again; -1: all.
            Default: 2.
        rescore: Score the estimates of all published rows again, as after a change of a metric.
        json: Print the result as one JSON document.
    """
    from .report import PUBLISHED_ROWS
    from .run import check_published, rescore_published
    from .run import publish as publish_results

    if check and rescore:
        raise ConfigError("--check and --rescore exclude each other")
    if results and (check or rescore):
        raise ConfigError(f"{results[0]}: --check and --rescore are for published rows and read no "
                          "results; name the folder of the rows with --to")
    if draw is not None and not check:
        raise ConfigError("--draw is for --check; leave it out")
    folder = to or PUBLISHED_ROWS
    if not check:
        written = (rescore_published(folder) if rescore
                   else publish_results(results or (Path("results"),), folder))
        return {"files": written} if json else "\n".join(map(str, written)), 0
    found = check_published(folder, 2 if draw is None else draw)
    code = 1 if found.problems else 0
    if json:
        return vars(found), code
    lines = [f"{found.rows} rows, {found.sequences} estimates scored again; truth of {found.drawn} "
             f"sequences drawn again: {len(found.problems)} differ"]
    return "\n".join([*lines, *(f"not drawn: {s}" for s in found.skipped), *found.problems]), code


def methods(json: bool = False) -> tuple[object, int]:
    """List the methods that `gcbench eval` knows by name.

    Examples:
      gcbench methods
      gcbench methods --json

    Args:
        json: Print the list as one JSON document.
    """
    from .. import list_methods
    from ..robots.catalog import records_table

    records = list_methods()
    return records if json else records_table(records), 0


def suites(json: bool = False) -> tuple[object, int]:
    """List the suites of datasets that `gcbench eval` knows by name.

    Examples:
      gcbench suites
      gcbench suites --json

    Args:
        json: Print the list as one JSON document.
    """
    from .. import list_suites
    from ..robots.catalog import records_table

    records = list_suites()
    return records if json else records_table(records), 0
