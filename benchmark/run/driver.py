"""Run methods on datasets and score them, resumably; a failing method does not stop the run.

Each estimate is stored at once. A run is scored when all of its estimates exist; shards of a run
are processes that share its folder, and the last one scores.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from ...errors import ConfigError, MethodError, printable
from ...renderer.cluster import ExecutorOptions, RayCluster, RayWorkers, connect_to_ray
from ...renderer.runtime import (
    AnyPath,
    Bar,
    convert_fields,
    cpu_count,
    defer_interrupts,
    parse_shard,
    require_local,
    say,
)
from ...renderer.scene import check_model_paths
from ...renderer.types import Inputs, Knowledge
from ..methods import (
    Declaration,
    is_own,
    method_identity,
    method_source,
    options_of,
    plan_rows,
    split_oracles,
    with_options,
)
from ..results import SCORES, Results, Row, Status, Stored
from .datasets import SUITES, Selection, from_folders, from_suite
from .estimation import estimate
from .isolation import Limits, read_declaration
from .jobs import Job, check_owners, describe_run, prepare_job, shorten_reason
from .schedule import Clock, cheap_first, describe_plan
from .suite import read_suite

_MOST_MEMORY = 1e6  # GiB; the system counts bytes of a limit in 63 bits


@dataclass(frozen=True)
class EvalConfig(ExecutorOptions):
    """Options of an evaluation: methods, data, limits and folders; executor, address and gpus."""

    method: tuple[str, ...] = ()
    """Methods to evaluate: registered names, module:attribute or FILE.py:attribute. The suffix
    @true-parts, @true-flow, @true-mask or some of them (@true-mask+true-flow) gives the method
    ground truth."""
    flow: str = ""
    """Optical flow, for methods with this option: dis, dis-fine, raft, raft:WEIGHTS,
    flownet2:CHECKPOINT or torchvision:NAME[:WEIGHTS] (torchvision downloads its own weights); or
    dis-fine+ and one of these names, such as dis-fine+raft, for two flows. Default: chosen by the
    method. Becomes part of the row's name."""
    depth: str = ""
    """Single-image depth, for methods with this option: none, mono:FOLDER (Monodepth2 weights) or
    hf:MODEL (a folder or OWNER/NAME on the Hugging Face hub, read by transformers; hf-metric and
    hf-relative say what it returns). Default: chosen by the method. Becomes part of the row's
    name."""
    foreground: str = ""
    """What finds the moving pixels of plain video, for methods with this option: network,
    network:WEIGHTS, background, no-people (leaves people out) or no-people:WEIGHTS. Default: chosen
    by the method. Becomes part of the row's name."""
    weights: tuple[str, ...] = ()
    """Trained weights, for methods with this option (screwnet, abbatematteo, dustnet,
    craves): a file that gcbench train wrote, or the name of weights that come with gcbench.
    METHOD=WEIGHTS is for one of the methods. Each makes a row."""
    set: tuple[str, ...] = ()
    """Settings of the method as NAME=VALUE, e.g. rgbd.candidates=800; part of the row's name."""
    suite: str = "mini"
    """Name or TOML file of a suite. Missing sequences are rendered first."""
    datasets: tuple[str, ...] = ()
    """Datasets of the suite to evaluate on, such as oven. Default: all."""
    data: tuple[AnyPath, ...] = ()
    """Dataset folders to use instead of a suite."""
    inputs: tuple[Inputs, ...] = ()
    """Input tracks to evaluate. Default: all that the method supports."""
    knowledge: tuple[Knowledge | Literal["all"], ...] = ()
    """Knowledge levels to evaluate; all: each that the method supports. Default: axes; all if the
    method does not support axes."""
    sequences: str = ""
    """Numbers of the sequences of each dataset to evaluate, such as 0-9,15. Default: all."""
    limit: int = 0
    """Largest number of sequences of each dataset. 0: all."""
    shard: str = ""
    """Evaluate a share of the sequences of each row, such as 3/64: those at the places 3, 67, 131,
    ... (from 0). Machines that share the folder of results may work at the same time; the last one
    scores. auto: as the variables of Slurm, AWS Batch, Kubernetes (auto/64) or torchrun say."""
    workers: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Number of parallel processes. They share the CPU cores; use 1 to compare run times.
    0: one for each core, or for each CPU of a Ray cluster. Default: as 0, without Ray at most 4."""
    results: AnyPath = Path("results")
    """Folder for estimates and scores."""
    timeout: float = 300.0
    """Time limit per sequence, s."""
    memory: float = 0.0
    """Largest private memory of each process of a method, GiB. 0: no limit."""
    python: str = ""
    """Python interpreter, or a script that runs one, for methods that are not gcbench's. It needs
    NumPy, and not gcbench."""
    retry: tuple[Status, ...] = ()
    """Statuses whose existing estimates are computed again. With ok, estimates of another
    version of the method or the dataset are replaced too."""
    keep_unobservable: bool = False
    """Also evaluate sequences whose motion cannot be observed in the images."""
    allow_model: bool = False
    """For knowledge model: read the models of --data from paths that the datasets name, or
    download them. Use it only for datasets that you trust."""
    suites: AnyPath = SUITES
    """Folder for the rendered datasets of suites."""


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
        MethodError: If no method can be loaded, or one does not support the requested options.
        DatasetError: If data cannot be read, or `config.results` contains estimates of another
            version of the method or of another dataset.

    Example:
        >>> import gcbench as gb
        >>> config = gb.EvalConfig(method=("hold-still",), data=("data/ur5",))
        >>> results = gb.evaluate(config, progress=False)
        >>> results.failures
        ()
        >>> finals = results.frame.query("metric == 'final_error'")
        >>> bool((finals.value > 0).all())
        True
    """
    config = convert_fields(config, EvalConfig)
    limits = _limits(config)
    require_local(Path(config.results), "--results")
    workers = config.choose_workers(config.workers)
    if not isinstance(workers, RayWorkers):
        return _evaluate(config, limits, None, progress)
    with connect_to_ray(workers) as cluster:
        count, cpus = cluster.plan()
        return _evaluate(config, replace(limits, workers=count, threads=cpus), cluster, progress)


def _evaluate(
    config: EvalConfig, limits: Limits, cluster: RayCluster | None, progress: bool
) -> Results:
    """Make what is missing, here or on a cluster, and return the results."""
    declared, rows, refused = _plan(config, limits)
    selection = Selection(config.sequences, config.limit, config.keep_unobservable,
                          config.datasets)
    if config.data:
        data = from_folders(config.data, selection, config.allow_model)
    else:
        data = from_suite(read_suite(config.suite), config.suites, selection, progress,
                          not config.shard, cluster and cluster.workers)
    recorded = {
        "seconds_per_sequence": limits.timeout, "workers": limits.workers,
        "threads": limits.threads, **({"memory": limits.memory} if limits.memory else {}),
    }  # fmt: skip
    for d in data:
        if not d.dataset.allow_model and any(row.knowledge == "model" for _, row in rows):
            check_model_paths(d.dataset.config)
    jobs = cheap_first([
        prepare_job(describe_run(row, source, d, recorded, declared[source]), d,
                    Path(config.results), config.retry, config.shard)
        for source, row in rows
        for d in data
    ])  # fmt: skip
    if progress:
        print(printable(describe_plan(jobs, limits.workers)), file=sys.stderr)
    refused |= _estimate(jobs, limits, cluster, progress)
    estimated = [job for job in jobs if job.folder.run.source not in refused]
    failures = [line for job in estimated for line in job.failures()]
    complete = [job for job in estimated if (job.folder.path / SCORES).exists()]
    return Results(
        runs=tuple(job.folder for job in complete),
        estimated=sum(len(job.todo) for job in estimated),
        usable=sum(len(job.share) for job in estimated) - len(failures),
        failures=(*map(shorten_reason, refused.values()), *failures),
        ended_early=tuple(map(shorten_reason, refused.values())),
        unfinished=tuple(job.describe_rest() for job in estimated if job not in complete),
    )


def _limits(config: EvalConfig) -> Limits:
    if not config.method:
        raise ConfigError("name a method: --method gcpose (or several)")
    if config.shard:
        parse_shard(config.shard, 1)  # fail before anything is rendered or read
        if "ok" in config.retry:
            raise ConfigError("--retry ok and --shard exclude each other: a shard that continues "
                              "would begin again; delete the folder of the row instead")
    if min(config.workers or 0, config.limit) < 0:
        raise ConfigError("--workers and --limit must be 0 or more")
    if not (config.timeout > 0 and math.isfinite(config.timeout)):
        raise ConfigError(f"--timeout {config.timeout:g}: expected a finite number of seconds "
                          "above 0")
    if not 0 <= config.memory <= _MOST_MEMORY:
        raise ConfigError(f"--memory {config.memory:g}: expected a finite number of GiB of at most "
                          f"{_MOST_MEMORY:g}, or 0 for no limit")
    workers = min(cpu_count(), 4) if config.workers is None else config.workers or cpu_count()
    if config.python and all(is_own(split_oracles(method)[0]) for method in config.method):
        raise ConfigError("--python is for methods that are not gcbench's; leave it out")
    return Limits(workers, max(1, cpu_count() // workers), config.timeout, config.memory,
                  config.python)


def _plan(
    config: EvalConfig, limits: Limits
) -> tuple[dict[str, Declaration], list[tuple[str, Row]], dict[str, str]]:
    """Return the declaration of each method by its identity, (identity, row) of each row, and why
    the other methods cannot be loaded. Raises MethodError if none can, if none has an option, or if
    two make the same row."""
    named = _with_options(config)
    found: dict[str, Declaration] = {}
    refused: dict[str, str] = {}
    for source in dict.fromkeys(source for source, _ in named):
        try:
            one = read_declaration(source, limits)
            plan_rows(one, (), config.inputs, _knowledge(config, one))
            found[source] = one
        except MethodError as error:
            refused[source] = str(error)
    if not found:
        raise MethodError("; ".join(refused.values()))
    for reason in refused.values():
        say(reason)
    declared = {one.source: one for one in found.values()}
    given, taken = ({option for source in sources for option in options_of(source).items()}
                    for sources in (dict(named), (*declared, *refused)))
    for name, value in sorted(given - taken):
        raise MethodError(f"no method here has the option --{name} (for {value}); leave it out")
    rows = [
        (found[source].source, row)
        for source, oracles in named if source in found
        for row in plan_rows(found[source], oracles, config.inputs,
                             _knowledge(config, found[source]))
    ]  # fmt: skip
    check_owners(rows)
    return declared, list(dict.fromkeys(rows)), refused


def _with_options(config: EvalConfig) -> list[tuple[str, tuple[str, ...]]]:
    """Return each method with all options that are meant for it, and its oracles; once for each of
    its weights. Raises MethodError for an unknown method."""
    methods = [split_oracles(method) for method in config.method]
    options = {"flow": config.flow, "depth": config.depth, "foreground": config.foreground,
               "set": " ".join(config.set)}
    out: dict[tuple[str, tuple[str, ...]], None] = {}
    for method, oracles in methods:
        method_source(method)  # fail on an unknown name before a process starts
        mine: list[str] = []
        for weights in config.weights:
            target, _, its = weights.partition("=")
            if not its or target not in dict(methods):
                mine.append(weights)
            elif target == method:
                mine.append(its)
        for weights in mine or [""]:
            given = {k: v for k, v in {**options, "weights": weights}.items() if v}
            out[with_options(method_identity(method), given), oracles] = None
    return list(out)


def _knowledge(config: EvalConfig, declared: Declaration) -> tuple[Knowledge, ...]:
    """Return the requested levels; by default axes where the method supports it."""
    if not config.knowledge and "axes" in declared.knowledge:
        return ("axes",)
    return tuple(k for k in config.knowledge if k != "all") if "all" not in config.knowledge else ()


def _estimate(
    jobs: Sequence[Job], limits: Limits, cluster: RayCluster | None, progress: bool
) -> dict[str, str]:
    """Compute and store the missing estimates and score each finished job. Returns why a method
    could not be run to its end, by its identity."""
    refused: dict[str, str] = {}
    total = sum(len(job.share) for job in jobs)
    todo = sum(len(job.todo) for job in jobs)
    clock = Clock(limits.workers, list(jobs))
    with _bar(total, total - todo, progress and todo > 0) as bar:
        for source in dict.fromkeys(job.folder.run.source for job in jobs):
            mine = [job for job in jobs if job.folder.run.source == source]
            try:
                with closing(estimate(source, mine, limits, cluster)) as answers:
                    _follow(answers, mine, clock, bar)
            except MethodError as error:
                refused[source] = f"{source}: {str(error).removeprefix(f'{source}: ')}"
                say(refused[source])
    if len(refused) == len({job.folder.run.source for job in jobs}):
        raise MethodError("; ".join(refused.values()))
    return refused


def _follow(
    answers: Iterable[tuple[Job, str, Stored]], jobs: Sequence[Job], clock: Clock, bar: Bar
) -> None:
    """Tell what is estimated, and score each job that is complete."""
    left = {job: len(job.todo) for job in jobs}
    for job in jobs:
        if not job.todo:
            job.finish()
    failed, before = 0, time.monotonic()
    for job, name, stored in answers:
        if line := job.describe_failure(name, stored):
            failed += 1
            say(line)
        clock.count(job, stored, time.monotonic() - before)
        before = time.monotonic()
        left_time = clock.remaining_time()
        more = [f"{left_time} left"] * bool(left_time) + [f"{failed} failed"] * bool(failed)
        bar.set_postfix_str(", ".join(more), refresh=False)
        bar.update()
        left[job] -= 1
        if not left[job]:
            job.finish()


def _bar(total: int, done: int, visible: bool) -> Bar:
    with defer_interrupts():
        return Bar(
            total=total, initial=done, unit="sequence", desc="estimate", disable=not visible,
            bar_format="{desc}: {percentage:3.0f}% {n_fmt}/{total_fmt} [{elapsed}{postfix}]",
            file=sys.stderr, dynamic_ncols=True, mininterval=0.1 if sys.stderr.isatty() else 10.0,
        )  # fmt: skip
