"""The command line: each command parses its options and makes one call of the public API.

The arguments of a command's function are its options, and its docstring is their help. Parts of
the package are imported when a command runs, so that `gcbench --help` answers at once.
"""

import os
import signal
import sys
import webbrowser
from collections.abc import Callable, Sequence
from io import TextIOWrapper
from pathlib import Path

import gcbench as gb
from gcbench.errors import printable, suggestion

HELP = """\
gcbench: synthetic videos of articulated objects with exact ground truth, and their benchmark.

usage: gcbench COMMAND [OPTIONS]     (completion: source <(gcbench --completion bash), or zsh, tcsh)

{commands}

examples:
  gcbench render --robot ur5 --n 20 --seed 7

`gcbench COMMAND --help` explains a command. `gcbench --version` prints the version.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code.

    0: success. 1: `verify` found an error, or no estimate of `eval` succeeded. 2: an error message,
    or nothing can render (`doctor`). 130: Ctrl-C. 141: the reader of the output has closed it.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # what its encoding does not have
    if not args or args[0] in ("-h", "--help", "help"):
        lines = [f"  {k:15} {(run.__doc__ or k).splitlines()[0]}" for k, run in COMMANDS.items()]
        print(HELP.format(commands="\n".join(lines)), end="")
        return 0
    if args[0] == "--version":
        return _say(f"gcbench {gb.__version__}")
    try:
        words = 2 if " ".join(args[:2]) in COMMANDS else 1
        code = _run(" ".join(args[:words]), args[words:])
        sys.stdout.flush()  # raises BrokenPipeError here, if at all
        return code
    except KeyboardInterrupt:
        print("gcbench: stopped; run the same command again to continue", file=sys.stderr)
        return 130
    except BrokenPipeError:  # as in `gcbench robots | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except OSError as error:  # a name that is too long, a full disk, a folder without permission
        where = f"{error.filename}: " if error.filename else ""
        problem = printable(f"{where}{error.strerror or error}")
    except gb.GcbenchError as error:
        problem = str(error)
    print(f"gcbench: {problem}", file=sys.stderr)
    return 2


def _run(name: str, args: Sequence[str]) -> int:
    """Run a command; one that takes no `args` has its own arguments as options."""
    from gcbench.renderer.runtime import command_line

    if name == "--completion":
        return _say(command_line.completion_script(COMMANDS, " ".join(args)))
    function = COMMANDS.get(name)
    if function is None:
        known = f"{suggestion(name, COMMANDS)}; there are {', '.join(COMMANDS)}"
        raise gb.ConfigError(f"no command {name!r}{known}")
    run = function if "args" in function.__annotations__ else command_line.command(name, function)
    return run(args)


def _say(*lines: object) -> int:
    """Print lines, which may hold names of any kind, and return the exit code of success."""
    print(*(printable(str(line)) for line in lines), sep="\n")
    return 0


def render(args: Sequence[str]) -> int:
    """Render a dataset: RGB, depth, part masks, optical flow, visibility and joint states.

    To continue an interrupted run, run the same command again.

    Examples:
      gcbench render --robot ur5 --n 1000
      gcbench render --robot model.urdf --package my_robot=~/ws/my_robot --n 10 --out out
      gcbench render --robot iiwa14 --n 50 --vary lights --camera.fov 30 30 --background.room 1
    """
    from gcbench.renderer.generate import command

    options = command.render_options(args, render.__doc__)
    done = gb.render_dataset(options.config, options.n, options.out, options.workers)
    return _say(done.describe())


def verify(
    dataset: Path, /, workers: int = os.cpu_count() or 1, sequences: str = "",
    allow_model: bool = False,
) -> int:
    """Check a dataset: recompute flow, visibility, poses and axes for every pixel and frame.

    Prints the worst and the mean residual of each check. The exit code is 1 if one is too large.

    Example:
      gcbench verify data/ur5

    Args:
        dataset: Folder of a dataset, or one sequence (ZIP or folder).
        workers: Processes that check sequences side by side.
        sequences: Numbers of sequences, such as 0-9,15. Default: all.
        allow_model: Read the model from a path that the dataset names.
    """
    report = gb.verify_dataset(dataset, workers, True, allow_model, sequences)
    _say(report.table())
    return 0 if report.ok else 1


def show(
    path: Path, /, index: int = 0, sequences: str = "", out: Path | None = None,
    contact_sheet: Path | None = None, gif: Path | None = None, mp4: Path | None = None,
    open: bool = False,
) -> int:
    """Show a sequence: a page with a frame slider, a contact sheet, a GIF or an MP4.

    Examples:
      gcbench show data/ur5 --contact-sheet ur5.png --gif ur5.gif --mp4 ur5.mp4

    Args:
        path: A dataset, or one sequence (ZIP or folder).
        index: Number of the sequence in the dataset.
        sequences: Instead of --index: sequences of the contact sheet, such as 0-9,15.
        out: HTML page. Default: SEQUENCE.html in the current folder, if no other file is named.
        contact_sheet: PNG, JPEG or WebP of the first frames of a dataset, or of a sequence.
        gif: GIF of the images beside their ground truth.
        mp4: MP4 of the same.
        open: Open the page in the browser.
    """
    if open and not out and (contact_sheet or gif or mp4):
        raise gb.ConfigError("--open needs a page: add --out PAGE.html")
    return _present(gb.show(path, out, contact_sheet, gif, mp4, sequences or index), open)


def export(
    dataset: Path, /, format: str, out: Path | None = None, sequences: str = "",
    allow_model: bool = False, track: str = "", knowledge: str = "",
) -> int:
    """Write a dataset in the format of another benchmark or tool.

    kitti: optical flow (KITTI 2015) and depth. bop: poses, meshes and masks of parts. coco: masks.
    webdataset, hf: shards for training. tapvid: point tracks. rerun: recordings for the Rerun
    viewer. observation: what a method may see. The same command continues an interrupted export.

    Examples:
      gcbench export data/ur5 --format observation --track rgbd-noise --knowledge axes

    Args:
        dataset: Folder of a dataset.
        format: kitti, bop, coco, webdataset, hf, tapvid, rerun or observation.
        out: Folder of the export, which must not exist. Default: DATASET-FORMAT.
        sequences: Numbers of sequences, such as 0-9,15. Default: all.
        allow_model: Read the model from a path that the dataset names, or download it.
        track: With the format observation: rgb, rgbd (default) or rgbd-noise.
        knowledge: With the format observation: free, axes (default) or kinematics.
    """
    out = out or dataset.parent / f"{dataset.absolute().name}-{format}"
    if (track or knowledge) and format != "observation":
        raise gb.ConfigError("--track and --knowledge need --format observation")
    done = (gb.export_observations(dataset, out, track or "rgbd", knowledge or "axes", sequences)
            if format == "observation" else
            gb.export_dataset(dataset, format, out, sequences, allow_model=allow_model))
    return _say(f"{done.folder}: {done.sequences} sequences, {done.frames} frames")


def robots() -> int:
    """List the robots that gcbench knows.

    `gcbench robots fetch` downloads their meshes, which also happens on first use. Any
    .urdf, .glb or .gltf file is a robot, too: give its path wherever a command takes a name.

    Example:
      gcbench robots
    """
    from gcbench.robots.catalog import robots_table

    return _say(robots_table(gb.list_robots()))


def fetch(names: tuple[str, ...] = (), /, all: bool = False) -> int:
    """Fetch the meshes of robots from the package index, once, with a pinned hash.

    For a cluster without network, fetch where there is one and copy the cache (GCBENCH_CACHE,
    default: gcbench in XDG_CACHE_HOME or ~/.cache).

    Example:
      gcbench robots fetch ur5 iiwa14

    Args:
        names: Robots of `gcbench robots`. Objects are generated, or yours.
        all: Fetch all robots.
    """
    if not names and not all:
        raise gb.ConfigError("name the robots to fetch, or give --all")
    if all:
        names = tuple(r.name for r in gb.list_robots() if r.source not in ("generated", "yours"))
    for name in names:
        _say(f"{name}: {gb.fetch_robot(name) or 'generated, nothing to fetch'}")
    return 0


def methods() -> int:
    """List the methods that `gcbench eval` knows by name.

    Example:
      gcbench methods
    """
    from gcbench.benchmark.methods import methods_table

    return _say(methods_table())


def suites() -> int:
    """List the suites of datasets that `gcbench eval` knows by name.

    Example:
      gcbench suites
    """
    from gcbench.benchmark.run import suites_table

    return _say(suites_table())


def doctor() -> int:
    """Check what renders on this machine, and how fast; the exit code is 2 if nothing does.

    Example:
      gcbench doctor
    """
    report = gb.doctor()
    _say(report.text)
    return 0 if report.ok else 2


def evaluate(args: Sequence[str]) -> int:
    """Run methods on datasets and score them.

    To continue an interrupted run, run the same command again. Each method runs in a separate
    process with a time limit. If it raises, hangs, crashes or returns an invalid estimate, that
    sequence is scored as no motion. At the end, a page of these results is written to
    RESULTS/report. The exit code is 1 if no estimate succeeded.

    Examples:
      gcbench eval --method gcpose
      gcbench eval --method icp icp@true-parts hold-still --data data/ur5 --inputs rgbd
      gcbench eval --method my_method.py:MyMethod --suite my_suite.toml --knowledge free
    """
    from gcbench.renderer.runtime import command_line

    options = command_line.parse_options(args, "eval", gb.EvalConfig, evaluate.__doc__)
    results = gb.evaluate(options)
    code = _print_results(results)
    return code or _say(gb.report(results, options.results / "report", False, False)[0])


def score(args: Sequence[str]) -> int:
    """Score the predictions of a method that ran elsewhere: a CSV or an NPZ file."""
    from gcbench.benchmark.run import ScoreConfig, score_predictions
    from gcbench.renderer.runtime import command_line

    options = command_line.parse_options(args, "score", ScoreConfig, ScoreConfig.__doc__)
    results = score_predictions(options)
    return _say(options.predictions) if options.template else _print_results(results)


def _print_results(results: "gb.Results") -> int:
    from gcbench.benchmark.report import leaderboard_text

    _say(leaderboard_text(results.runs), *(f"failed: {line}" for line in results.failures),
         *dict.fromkeys(folder.path for folder in results.runs))
    if not results.usable:
        print("gcbench: no sequence was estimated", file=sys.stderr)
    return 0 if results.usable else 1


def report(
    results: tuple[Path, ...] = (Path("results"),), /, out: Path = Path("report"),
    pictures: bool = True, label: tuple[str, ...] = (), allow_model: bool = False,
    open: bool = False,
) -> int:
    """Report results as a page, CSV, Markdown and LaTeX: a leaderboard with shared ranks.

    Examples:
      gcbench report results others/results --label others=others/results --open

    Args:
        results: Folders that `gcbench eval` and `gcbench score` wrote.
        out: Folder of the report.
        pictures: Draw the worst and the median sequence of each row (needs a renderer).
        label: NAME=FOLDER adds NAME to the methods of a results folder.
        allow_model: Read models from paths that the datasets name, or download them.
        open: Open the page in the browser.
    """
    return _present(gb.report(results, out, pictures, labels=label, allow_model=allow_model), open)


def _present(written: Sequence[Path], open: bool) -> int:
    """Name the files; open the first, which is a page, in the browser."""
    if open:
        webbrowser.open(written[0].resolve().as_uri())
    return _say(*written)


def train_flow(args: Sequence[str]) -> int:
    """Train the optical flow network of GC-Pose."""
    return _train("flow", args)


def train_screwnet(args: Sequence[str]) -> int:
    """Train ScrewNet, a baseline: the screw motion of one joint from depth video."""
    return _train("screwnet", args)


def _train(name: str, args: Sequence[str]) -> int:
    from gcbench.gcpose.training.config import CONFIGS
    from gcbench.renderer.runtime import command_line

    config = CONFIGS[name]
    options = command_line.parse_options(args, f"train {name}", config, config.__doc__)
    from gcbench.gcpose.training.tasks import run_training

    return _say(run_training(options))


COMMANDS: dict[str, Callable[..., int]] = {
    "render": render, "verify": verify, "show": show, "robots": robots, "doctor": doctor,
    "eval": evaluate, "score": score, "report": report, "export": export,
    "methods": methods, "suites": suites, "robots fetch": fetch, "train flow": train_flow,
    "train screwnet": train_screwnet,
}

if __name__ == "__main__":
    sys.exit(main())
