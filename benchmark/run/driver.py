"""Run methods on datasets and score them: resumable, with progress, whatever a method does.

Estimates are stored one by one; scores are derived from them when a row has all of a dataset.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ... import __version__
from ...errors import ConfigError, DatasetError, GcbenchError
from ...renderer.dataset import package_versions
from ...renderer.runtime import Bar, dump_json, uninterrupted
from ...renderer.scene import differences
from ...renderer.types import Inputs, Knowledge
from ...robots.files import remove_leftovers, write_atomically
from ..methods import Declaration, identify, locate, plan_rows, split, with_options
from ..protocol import score_sequence, shape_of
from ..results import (
    ESTIMATES,
    RUN,
    SCORES,
    Result,
    Results,
    Row,
    Run,
    RunFolder,
    Status,
    Stored,
    read_run,
    read_stored,
    run_folder,
    write_run,
    write_scores,
)
from .datasets import SUITES, Data, from_folders, from_suite
from .isolation import ask, run
from .method_worker import Task
from .suite import read_suite


@dataclass(frozen=True)
class EvalConfig:
    """What to evaluate, on what, and within which limits."""

    method: tuple[str, ...] = ()
    """Names of methods, module:attribute or FILE.py:attribute; @true-parts, @true-flow or
    @true-parts+true-flow make an oracle row of one."""
    flow: str = ""
    """Optical flow for methods that let one choose: dis, dis-fine, raft, raft:WEIGHTS or
    flownet2:CHECKPOINT; default: the method's own. The row's name says it."""
    depth: str = ""
    """Depth from single images, likewise: none, or mono:FOLDER with Monodepth2's weights."""
    set: tuple[str, ...] = ()
    """Settings of the method, as NAME=VALUE: rgbd.candidates=800. The row's name lists them."""
    suite: str = "mini"
    """Name of a suite, or a TOML file; its missing sequences are rendered first."""
    data: tuple[Path, ...] = ()
    """Datasets instead of a suite."""
    inputs: tuple[Inputs, ...] = ()
    """Default: every track that the method supports."""
    knowledge: tuple[Knowledge, ...] = ()
    """Default: every level that the method supports."""
    workers: int = 1
    """Processes that estimate side by side; the cores are shared between them, so that times
    are comparable at 1 only."""
    results: Path = Path("results")
    """Where estimates and scores go."""
    timeout: float = 300.0
    """Time limit of one estimate, s."""
    retry: tuple[Status, ...] = ()
    """Estimates of these statuses are thrown away and made again; ok: also those of another
    version of the method."""
    keep_unobservable: bool = False
    """Evaluate sequences whose motion cannot be seen, too."""
    suites: Path = SUITES
    """Where suites are rendered."""


@dataclass(frozen=True)
class Job:
    """A row on a dataset, on its way."""

    folder: RunFolder
    data: Data
    todo: tuple[str, ...]


def evaluate(config: EvalConfig, progress: bool = True) -> Results:
    """Run methods on datasets and score them.

    Estimates that already exist in `config.results` are not made again: after an interruption
    (KeyboardInterrupt) the same call continues. Each method runs in processes of its own; what it
    raises, or a crash or a timeout, costs that sequence, never the run.

    Args:
        config: The methods, the data and the limits.
        progress: Show a progress bar on stderr.

    Returns:
        The runs, one for each row (method, inputs, knowledge, oracles) and dataset, with all
        scores as a pandas frame.

    Raises:
        ConfigError: For an invalid option.
        MethodError: If a method cannot be loaded or does not support what was asked for.
        DatasetError: If data cannot be read, or `config.results` holds results of another version
            of the method or of another dataset.

    Example:
        >>> import gcbench as gb
        >>> from pathlib import Path
        >>> config = gb.EvalConfig(method=("hold-still",), data=(Path("data/ur5"),))
        >>> results = gb.evaluate(config, progress=False)
        >>> results.failures
        ()
        >>> finals = results.frame.query("metric == 'final_error'")
        >>> bool((finals.value > 0).all())
        True
    """
    _check(config)
    declared, rows = _plan(config)
    if config.data:
        data = from_folders(config.data, config.keep_unobservable)
    else:
        suite = read_suite(config.suite)
        data = from_suite(suite, config.suites, None, config.keep_unobservable, progress, _say)
    threads = max(1, cpu_count() // config.workers)
    limits = {
        "seconds_per_sequence": config.timeout, "workers": config.workers, "threads": threads,
    }  # fmt: skip
    jobs = [
        prepare(describe_run(row, source, d, limits, declared[source].settings), d,
                config.results, config.retry)
        for source, row in rows
        for d in data
    ]
    done = _estimate(jobs, config, threads, progress)
    return Results(tuple(job.folder for job in jobs), done, tuple(_failures(jobs)))


def _plan(config: EvalConfig) -> tuple[dict[str, Declaration], list[tuple[str, Row]]]:
    """What each method declares, by its identity, and the rows to evaluate with their method."""
    options = {k: v for k, v in (("flow", config.flow), ("depth", config.depth),
                                 ("set", " ".join(config.set))) if v}
    for name, _ in map(split, config.method):
        locate(name)  # an unknown name is an error before a process starts
    named = [(with_options(identify(method), options), oracles)
             for method, oracles in map(split, config.method)]
    declared = {source: ask(source) for source in dict.fromkeys(source for source, _ in named)}
    rows = [
        (source, row)
        for source, oracles in dict.fromkeys(named)
        for row in plan_rows(declared[source], oracles, config.inputs, config.knowledge)
    ]
    return declared, rows


def prepare(new: Run, data: Data, results: Path, retry: Sequence[Status] = ()) -> Job:
    """Make or reopen the folder of a run, and see what is left to do.

    Raises DatasetError if the folder holds estimates of something else.
    """
    path = run_folder(results, new.row, new.dataset)
    estimates = path / ESTIMATES
    if (path / RUN).exists() and estimates.is_dir() and any(estimates.glob("*.zip")):
        old = read_run(path / RUN)
        changed = differences(_identity(old), _identity(new))
        if changed and "ok" in retry:
            for file in estimates.glob("*.zip"):
                file.unlink()
        elif changed:
            raise DatasetError(
                f"{path} holds estimates of something else ({'; '.join(changed)}); choose another "
                "--results folder, delete this one, or discard them by --retry ok"
            )
        there = [e for e in old.environments if e not in new.environments]
        new = replace(new, environments=(*there, *new.environments))
    folder = RunFolder(path, new)
    write_run(path, new)
    estimates.mkdir(exist_ok=True)
    remove_leftovers(estimates)
    todo = [s for s in new.sequences if not _is_done(folder, data, s, retry)]
    if todo:
        (path / SCORES).unlink(missing_ok=True)  # it would be of other estimates
    return Job(folder, data, tuple(todo))


def score_run(folder: RunFolder, data: Data) -> list[Result]:
    """Score every stored estimate of a run, write the table, and return its lines.

    Raises DatasetError if an estimate is missing or damaged.
    """
    out: list[Result] = []
    for name in folder.run.sequences:
        sequence = data.dataset[name]
        stored = read_stored(folder.estimate_path(name), shape_of(sequence))
        out += score_sequence(sequence, stored, folder.run, name, data.cluster(name))
    write_scores(folder.path / SCORES, out)
    return out


def describe_environment() -> dict[str, Any]:
    """Versions and machine, without its name."""
    cpu = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((x.partition(":")[2].strip() for x in lines if x.startswith("model name")), cpu)
    except OSError:
        pass
    here = package_versions()
    return {"gcbench": __version__, **here, "cpu": cpu, "cores": cpu_count()}


def cpu_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _check(config: EvalConfig) -> None:
    if not config.method:
        raise ConfigError("name a method: --method gcpose (or several)")
    if config.workers < 1 or not config.timeout > 0:
        raise ConfigError("--workers and --timeout must be more than 0")


def describe_run(row: Row, source: str, data: Data, limits: dict[str, Any],
                 settings: Mapping[str, Any]) -> Run:
    """What `run.json` says of a row on a dataset, here and now."""
    info = data.dataset.info
    return Run(
        row=row, source=source, dataset=data.name, data=str(data.dataset.path), config=info.config,
        assets=info.assets, sequences=data.sequences, left_out=data.left_out, limits=limits,
        environments=(describe_environment(),), settings=settings,
    )  # fmt: skip


def _identity(run: Run) -> dict[str, Any]:
    """What must be equal for estimates to stand in one row."""
    row = run.row
    tree = {
        "version": row.version, "training": row.training, "source": identify(run.source),
    }  # fmt: skip
    return json.loads(dump_json({**tree, "config": run.config}))


def _is_done(folder: RunFolder, data: Data, sequence: str, retry: Sequence[Status]) -> bool:
    path = folder.estimate_path(sequence)
    if not path.exists():
        return False
    try:
        return read_stored(path, shape_of(data.dataset[sequence])).status not in retry
    except GcbenchError:
        return False  # damaged


def _estimate(jobs: list[Job], config: EvalConfig, threads: int, progress: bool) -> int:
    """Run what is to do, write each estimate as it comes, score each job when it is whole."""
    total = sum(len(job.folder.run.sequences) for job in jobs)
    todo = sum(len(job.todo) for job in jobs)
    with _bar(total, total - todo, progress and todo > 0) as bar:
        for source in dict.fromkeys(job.folder.run.source for job in jobs):
            mine = [job for job in jobs if job.folder.run.source == source]
            _estimate_by(source, mine, config, threads, bar)
    return todo


def _estimate_by(source: str, jobs: list[Job], config: EvalConfig, threads: int, bar: Bar) -> None:
    """All rows of one method, by one crew."""
    owner: dict[Task, Job] = {}
    for job in jobs:
        row = job.folder.run.row
        for name in job.todo:
            path = str(job.data.dataset.path)
            owner[Task(path, name, row.inputs, row.knowledge, row.oracles)] = job
        if not job.todo:
            score_run(job.folder, job.data)
    left = Counter(id(job) for job in owner.values())
    failed = 0
    with closing(run(source, list(owner), config.workers, threads, config.timeout)) as answers:
        for task, data in answers:
            job = owner[task]
            path = job.folder.estimate_path(task.sequence)
            write_atomically(path, data)
            stored = _stored(job, task.sequence)
            if stored.status != "ok":
                failed += 1
                reason = stored.reason.splitlines()[0] if stored.reason else ""
                title = f"{job.folder.run.row.title}: {job.folder.run.dataset}/{task.sequence}"
                bar.write(f"gcbench: {title}: {stored.status}: {reason}", file=sys.stderr)
                bar.set_postfix(failed=failed)
            bar.update()
            left[id(job)] -= 1
            if not left[id(job)]:
                bar.set_description(f"score {job.folder.run.row.name}")
                score_run(job.folder, job.data)
                bar.set_description("estimate")


def _bar(total: int, done: int, visible: bool) -> Bar:
    with uninterrupted():
        return Bar(
            total=total, initial=done, unit="sequence", desc="estimate", smoothing=0.1,
            disable=not visible, file=sys.stderr, dynamic_ncols=True,
        )  # fmt: skip


def _failures(jobs: Iterable[Job]) -> Iterable[str]:
    for job in jobs:
        for name in job.folder.run.sequences:
            stored = _stored(job, name)
            if stored.status != "ok":
                first = stored.reason.splitlines()[0] if stored.reason else ""
                run = job.folder.run
                yield f"{run.row.title} on {run.dataset}/{name}: {stored.status}: {first}"


def _stored(job: Job, name: str) -> Stored:
    return read_stored(job.folder.estimate_path(name), shape_of(job.data.dataset[name]))


def _say(line: str) -> None:
    print(line, file=sys.stderr)
