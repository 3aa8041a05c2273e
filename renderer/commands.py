"""The commands `gcbench render`, `submit`, `verify`, `show`, `export` and `doctor`."""

import os
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ConfigError


def render(args: Sequence[str]) -> tuple[object, int]:
    """Render a dataset: images, exact ground truth and joint states.

    Each frame has RGB, depth, part masks, optical flow and visibility. To continue an interrupted
    run, run the same command again.

    Examples:
      gcbench render --robot ur5 --n 1000
      gcbench render --robot model.urdf --package my_robot=~/ws/my_robot --n 10 --out out
      gcbench render --robot iiwa14 --n 50 --vary lights --camera.fov 30 30 --background.room 1
      gcbench render --robot microwave --randomize none --layers normal tracks
    """
    from .. import render_dataset
    from .generate import options

    given = options.render_options(args, render.__doc__)
    _choose_device(given.device)
    done = render_dataset(given.config, given.n, given.out, given.workers, not given.quiet)
    return done if given.json else done.describe(), 0


def submit(args: Sequence[str]) -> tuple[object, int]:
    """Run a command on a cluster: an array job of Slurm, one shard of the work in each job.

    What follows -- is a command that has the option --shard. The jobs share its folder. A job that
    is pre-empted or reaches its time limit is queued again and continues. To continue a submission
    that ended early, submit the same command again. Needs `pip install '.[cluster]'`.

    Examples:
      gcbench submit --shards 64 --cpus 8 -- render --robot ur5 --n 100000 --out /shared/ur5
      gcbench submit --partition short --time 60 --wait -- render --robot microwave --n 5000
      gcbench submit --slurm account=robots mem=16G -- render --robot iiwa14 --n 1000
      gcbench submit --executor local --shards 2 --cpus 1 --wait -- render --robot ur5 --n 20
      gcbench submit --shards 16 -- eval --method gcpose --data /shared/ur5 --results /shared/out
      gcbench submit --shards 16 -- verify /shared/ur5
    """
    from .cluster import SubmitConfig, submit_shards, wait_for_shards
    from .generate import options as of_render
    from .runtime import command_line, plural, say

    @dataclass(frozen=True)
    class Submit(command_line.OutputOptions, SubmitConfig):
        wait: bool = False
        """Wait until all jobs have ended. The exit code is 1 if one failed."""

    end = args.index("--") if "--" in args else len(args)
    mine, command = (args[:end], args[end + 1:]) if end < len(args) else (args, [])
    config: Any = command_line.parse_options(mine, "submit", Submit, submit.__doc__)
    if not command:
        raise ConfigError("give a command after --, as in gcbench submit -- render --robot ur5")
    if command[0] == "render":
        of_render.render_options(command[1:], render.__doc__)  # refuses before the queue
    jobs = submit_shards(command, config)
    if config.wait and not config.quiet:
        say(jobs.describe())
    failures = wait_for_shards(jobs, not config.quiet) if config.wait else ""
    if failures:
        say(failures)
    record = {"jobs": [job.job_id for job in jobs.jobs], "cluster": jobs.cluster,
              "logs": jobs.logs, "ok": not failures if config.wait else None}
    count = len(jobs.jobs)
    ended = f"{plural(count, 'shard')} {'has' if count == 1 else 'have'} ended"
    ended += ", not all well" * bool(failures)
    text = ended if config.wait else jobs.describe()
    return record if config.json else text, 1 if failures else 0


def verify(
    dataset: Path, /, workers: int = 0, sequences: str = "", shard: str = "",
    merge: bool = False, reports: Path | None = None, allow_model: bool = False,
    quiet: bool = False, json: bool = False,
) -> tuple[object, int]:
    """Check a dataset: compute its ground truth in a second way.

    Recomputes flow, visibility, poses and axes for every pixel and frame. Prints the
    worst and the mean residual of each check. The exit code is 1 if one is too large. Processes
    on several machines may share the work: each verifies a --shard, then --merge makes the report.

    Examples:
      gcbench verify data/ur5
      gcbench verify data/ur5 --sequences 0-9,15 --workers 4
      gcbench verify data/ur5/sequences/000000.zip
      gcbench verify /shared/ur5 --shard 3/64 --reports /shared/ur5-verify
      gcbench verify /shared/ur5 --merge --reports /shared/ur5-verify

    Args:
        dataset: Folder of a dataset, or one sequence (ZIP or folder).
        workers: Processes that check sequences side by side. 0: one for each core.
        sequences: Numbers of sequences, such as 0-9,15. Default: all.
        shard: Check a share of the sequences, such as 3/64: those at the places 3, 67, 131, ...
            (from 0). Write what is found to a file.
            auto: as the variables of Slurm, AWS Batch, Kubernetes (auto/64) or torchrun say.
        merge: Make one report of the files of all shards.
        reports: Folder of the files of the shards. Default: DATASET-verify.
        allow_model: Read the model from a path that the dataset names.
        quiet: Show no progress: print the result and errors only.
        json: Print the result as one JSON document.
    """
    from .. import merge_verification, verify_dataset, verify_shard

    if bool(shard) + merge + bool(sequences) > 1:
        raise ConfigError("--shard, --merge and --sequences exclude each other; give one of them")
    if reports and not (shard or merge):
        raise ConfigError("--reports is for --shard and --merge; leave it out")
    if shard:
        report = verify_shard(dataset, shard, reports, workers, not quiet, allow_model)
    elif merge:
        report = merge_verification(dataset, reports)
    else:
        report = verify_dataset(dataset, workers, not quiet, allow_model, sequences)
    record = {"ok": report.ok, "checks": report.checks, "warnings": report.warnings}
    return record if json else report.table(), 0 if report.ok else 1


def show(
    path: Path, /, index: int | None = None, sequences: str = "", out: Path | None = None,
    contact_sheet: Path | None = None, gif: Path | None = None, mp4: Path | None = None,
    rerun: bool = False, open: bool = False, allow_model: bool = False,
) -> tuple[object, int]:
    """Show a dataset as pages, a contact sheet, a GIF or an MP4.

    A dataset gives a folder: an index, and pages of its first ten sequences, or of --sequences. The
    same command continues an interrupted run. With --index, one sequence gives one page.

    Examples:
      gcbench show data/ur5 --open
      gcbench show data/ur5 --index 3 --out ur5.html
      gcbench show data/ur5 --contact-sheet ur5.png --gif ur5.gif --mp4 ur5.mp4
      gcbench show data/ur5 --index 3 --rerun

    Args:
        path: A dataset, or one sequence (ZIP or folder).
        index: Number of the sequence in the dataset.
        sequences: Instead of --index: sequences of the pages and the contact sheet, such as
            0-9,15.
        out: Folder of the pages; a name in .html for the page of one sequence. Default, if no
            other file is named: DATASET-show, or SEQUENCE.html, in the current folder (beside the
            dataset if that is the current folder).
        contact_sheet: PNG, JPEG or WebP: of a dataset the first frame of each sequence; of one
            sequence its images, depth, parts and flow over time.
        gif: GIF of the images beside their ground truth.
        mp4: MP4 of the same.
        rerun: Write DATASET-SEQUENCE.rrd, and open it in the viewer of Rerun.
        open: Open the page in the browser.
        allow_model: Read the model of the 3D view from a path that the dataset names.
    """
    from .. import open_dataset
    from .. import show as write_pictures
    from .dataset import DATASET_FILE
    from .export import open_rerun, record_for_rerun
    from .runtime import exists, say

    pictures = bool(contact_sheet or gif or mp4 or rerun)
    if open and not out and pictures:
        raise ConfigError("--open needs a page: add --out PAGE.html")
    if sequences and index is not None:
        raise ConfigError("--index and --sequences exclude each other; give one of them")
    if index is not None and index < 0:
        raise ConfigError(f"--index {index}: give the number of a sequence, 0 or more")
    chosen = sequences or index
    written: list[Path] = []
    if out or not pictures or contact_sheet or gif or mp4:
        allowed = allow_model and exists(path / DATASET_FILE)
        shown = open_dataset(path, allow_model=True) if allowed else path
        written += write_pictures(shown, out, contact_sheet, gif, mp4, chosen)
    if rerun:
        written.append(record_for_rerun(path, "" if chosen is None else str(chosen), allow_model))
        if hint := open_rerun(written[-1]):
            say(hint)
    if open:
        webbrowser.open(written[0].resolve().as_uri())
    return "\n".join(map(str, written)), 0


def export(
    dataset: Path, /, format: str, out: Path | None = None, sequences: str = "",
    allow_model: bool = False, track: str = "", knowledge: str = "", quiet: bool = False,
) -> tuple[object, int]:
    """Write a dataset in the format of another benchmark or tool.

    kitti: optical flow (KITTI 2015) and depth. bop: poses, meshes and masks of parts. coco: masks.
    webdataset, hf: shards for training. tapvid: point tracks. rerun: recordings for the Rerun
    viewer. screwnet: depth video and screws as the code of ScrewNet reads them. observation: what a
    method may see. The same command continues an interrupted export.

    Examples:
      gcbench export data/ur5 --format kitti
      gcbench export data/ur5 --format hf --out ur5-hf --sequences 0-99
      gcbench export data/ur5 --format observation --track rgbd-noise --knowledge axes

    Args:
        dataset: Folder of a dataset.
        format: kitti, bop, coco, webdataset, hf, tapvid, rerun, screwnet or observation.
        out: Folder of the export, which must not exist. Default: DATASET-FORMAT, beside the
            dataset.
        sequences: Numbers of sequences, such as 0-9,15. Default: all.
        allow_model: Read the model from a path that the dataset names, or download it.
        track: With the format observation: rgb, rgbd (default) or rgbd-noise.
        knowledge: With the format observation: free, axes (default) or kinematics.
        quiet: Show no progress: print the result and errors only.
    """
    from .. import export_dataset, export_observations
    from .dataset import default_output
    from .runtime import is_remote

    beside = Path() if is_remote(dataset) else dataset.parent
    out = out or beside / default_output(dataset, f"-{format}")
    if (track or knowledge) and format != "observation":
        raise ConfigError("--track and --knowledge need --format observation")
    done = (export_observations(dataset, out, track or "rgbd", knowledge or "axes", sequences,
                                not quiet)
            if format == "observation" else
            export_dataset(dataset, format, out, sequences, not quiet, allow_model))
    return f"{done.folder}: {done.sequences} sequences, {done.frames} frames", 0


def doctor(device: str = "", json: bool = False) -> tuple[object, int]:
    """Check what renders on this machine, and how fast.

    The exit code is 2 if nothing renders.

    Examples:
      gcbench doctor
      gcbench doctor --device gpu
      gcbench doctor --json

    Args:
        device: What must draw, as for `gcbench render`. Default: what draws there.
        json: Print the result as one JSON document.
    """
    from .. import doctor as examine

    _choose_device(device)
    report = examine()
    record = {"ok": report.ok, **report.sections}
    return record if json else report.text, 0 if report.ok else 2


def _choose_device(device: str) -> None:
    """Have this process and those that it starts draw on a device; "" leaves the choice."""
    if device:
        from .gl import DEVICE_VARIABLE

        os.environ[DEVICE_VARIABLE] = device
