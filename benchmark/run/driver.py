"""Run methods on datasets and score them, resumably; a failing method does not stop the run.

Each estimate is stored at once. A run is scored when all of its estimates exist.
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
from ...renderer.dataset import environment
from ...renderer.runtime import Bar, dump_json, uninterrupted
from ...renderer.scene import differences
from ...renderer.types import Inputs, Knowledge
from ...robots.files import remove_leftovers, write_atomically
from ..methods import (
    Declaration,
    method_identity,
    method_source,
    plan_rows,
    split_oracles,
    with_options,
)
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
from .isolation import read_declaration, run
from .method_worker import Task
from .suite import read_suite


@dataclass(frozen=True)
class EvalConfig:
    """Options of an evaluation: methods, data, limits and folders."""

    method: tuple[str, ...] = ()
    """Methods to evaluate: registered names, module:attribute or FILE.py:attribute. The suffix
    @true-parts, @true-flow or @true-parts+true-flow gives the method ground truth."""
    flow: str = ""
    """Optical flow, for methods with this option: dis, dis-fine, raft, raft:WEIGHTS or
    flownet2:CHECKPOINT. Default: chosen by the method. Becomes part of the row's name."""
    depth: str = ""
    """Single-image depth, for methods with this option: none, or mono:FOLDER (Monodepth2 weights).
    Default: chosen by the method. Becomes part of the row's name."""
    set: tuple[str, ...] = ()
    """Settings of the method as NAME=VALUE, e.g. rgbd.candidates=800; part of the row's name."""
    suite: str = "mini"
    """Name or TOML file of a suite. Missing sequences are rendered first."""
    data: tuple[Path, ...] = ()
    """Dataset folders to use instead of a suite."""
    inputs: tuple[Inputs, ...] = ()
    """Input tracks to evaluate. Default: all that the method supports."""
    knowledge: tuple[Knowledge, ...] = ()
    """Knowledge levels to evaluate. Default: all that the method supports."""
    workers: int = 1
    """Number of parallel processes. They share the CPU cores; use 1 to compare run times."""
    results: Path = Path("results")
    """Folder for estimates and scores."""
    timeout: float = 300.0
    """Time limit per sequence, s."""
    retry: tuple[Status, ...] = ()
    """Statuses whose existing estimates are computed again. With ok, estimates of another
    version of the method or the dataset are replaced too."""
    keep_unobservable: bool = False
    """Also evaluate sequences whose motion cannot be observed in the images."""
    suites: Path = SUITES
    """Folder for the rendered datasets of suites."""


@dataclass(frozen=True)
class Job:
    """A row on a dataset, and the names of the sequences without an estimate."""

    folder: RunFolder
    data: Data
    todo: tuple[str, ...]


def evaluate(config: EvalConfig, progress: bool = True) -> Results:
    """Run methods on datasets and score them.

    Existing estimates in `config.results` are reused, so the same call continues an interrupted
    evaluation. Each method runs in separate processes; an exception, a crash or a timeout is
    recorded as the failure of one sequence, and the evaluation continues.

    Args:
        config: Methods, data, limits and folders.
        progress: Show a progress bar on stderr.

    Returns:
        One run per row (method, inputs, knowledge, oracles) and dataset; `frame` has all scores
        as a pandas DataFrame.

    Raises:
        ConfigError: For an invalid option.
        MethodError: If a method cannot be loaded or does not support the requested options.
        DatasetError: If data cannot be read, or `config.results` contains estimates of another
            version of the method or of another dataset.

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
    """Return the declaration of each method by its identity, and (identity, row) of each row."""
    options = {k: v for k, v in (("flow", config.flow), ("depth", config.depth),
                                 ("set", " ".join(config.set))) if v}
    for name, _ in map(split_oracles, config.method):
        method_source(name)  # fail on an unknown name before a process starts
    named = [(with_options(method_identity(method), options), oracles)
             for method, oracles in map(split_oracles, config.method)]
    declared = {source: read_declaration(source) for source in dict.fromkeys(s for s, _ in named)}
    rows = [
        (source, row)
        for source, oracles in dict.fromkeys(named)
        for row in plan_rows(declared[source], oracles, config.inputs, config.knowledge)
    ]
    return declared, rows


def prepare(new: Run, data: Data, results: Path, retry: Sequence[Status] = ()) -> Job:
    """Create or reopen the folder of a run, and find the sequences without an estimate.

    Raises DatasetError if the folder has estimates of another method version or dataset.
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
        (path / SCORES).unlink(missing_ok=True)  # outdated by the new estimates
    return Job(folder, data, tuple(todo))


def score_run(folder: RunFolder, data: Data) -> list[Result]:
    """Score every stored estimate of a run, write the table and return its lines.

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
    """Return package versions, CPU model and core count; no host name."""
    cpu = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((x.partition(":")[2].strip() for x in lines if x.startswith("model name")), cpu)
    except OSError:
        pass
    here = environment()
    return {"gcbench": __version__, **here, "cpu": cpu, "cores": cpu_count()}


def cpu_count() -> int:
    """Return the number of CPU cores available to this process."""
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
    """Return the record that `run.json` stores for a row on a dataset, with this environment."""
    info = data.dataset.info
    return Run(
        row=row, source=source, dataset=data.name, data=str(data.dataset.path), config=info.config,
        assets=info.assets, sequences=data.sequences, left_out=data.left_out, limits=limits,
        environments=(describe_environment(),), settings=settings,
    )  # fmt: skip


def _identity(run: Run) -> dict[str, Any]:
    """Return the fields that are equal in all estimates of one row."""
    row = run.row
    tree = {
        "version": row.version, "training": row.training, "source": method_identity(run.source),
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
    """Compute and store the missing estimates, score each finished job, return their number."""
    total = sum(len(job.folder.run.sequences) for job in jobs)
    todo = sum(len(job.todo) for job in jobs)
    with _bar(total, total - todo, progress and todo > 0) as bar:
        for source in dict.fromkeys(job.folder.run.source for job in jobs):
            mine = [job for job in jobs if job.folder.run.source == source]
            _estimate_by(source, mine, config, threads, bar)
    return todo


def _estimate_by(source: str, jobs: list[Job], config: EvalConfig, threads: int, bar: Bar) -> None:
    """Estimate all rows of one method with one pool of workers."""
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
