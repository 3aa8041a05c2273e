"""Jobs of Slurm, or processes of this machine, each of which works on one shard (submitit)."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ...errors import ConfigError, RenderError, suggestion
from ..runtime import require_local
from .shard_job import ShardJob

if TYPE_CHECKING:
    from submitit import AutoExecutor, Job

SHARDED = ("render", "eval", "verify")
"""Commands that have the option --shard."""
_ALONE = {"render": ("--sequences",), "verify": ("--merge", "--sequences")}
"""Options that --shard excludes."""
_MOST = 100_000  # shards
_REQUEUES = 1000  # at the time limit; ends a loop without progress


@dataclass(frozen=True)
class SubmitConfig:
    """How the shards of a command run."""

    shards: int = 8
    """Number of jobs; each works on one shard."""
    executor: Literal["auto", "slurm", "local"] = "auto"
    """slurm: an array job. local: processes of this machine, all at once. auto: slurm where there
    is one."""
    partition: str = ""
    """Partition of Slurm. Default: that of the cluster."""
    cpus: int = 4
    """CPU cores of a job; also its --workers, if the command does not say."""
    gpus: int = 0
    """GPUs of a job."""
    time: int = 240
    """Time limit of a job, minutes. A job that reaches it is queued again and continues."""
    parallel: int = 0
    """Largest number of jobs that run at the same time (Slurm). 0: all."""
    slurm: tuple[str, ...] = ()
    """Other options of sbatch as NAME=VALUE, e.g. account=robots mem=16G."""
    logs: Path = Path("logs")
    """Folder for the output of the jobs. The jobs must see it."""


@dataclass(frozen=True)
class Submission:
    """Jobs that were handed over, one for each shard."""

    jobs: Sequence[Job[None]]
    """By shard."""
    cluster: str
    """"slurm" or "local"."""
    logs: Path

    @property
    def array(self) -> str:
        """The number of the array job."""
        return self.jobs[0].job_id.partition("_")[0]

    def log(self, index: int) -> Path:
        """The file with the errors and the progress of a shard."""
        return Path(self.jobs[index].paths.stderr)

    def describe(self) -> str:
        """What was submitted, where its output goes, and how to look after it."""
        several = len(self.jobs) > 1
        lines = [f"{len(self.jobs)} shards as jobs of {self.cluster}: "
                 + ", ".join(job.job_id for job in self.jobs[:3]) + ", ..." * (len(self.jobs) > 3)]
        logs = self.logs / (f"{self.array}_*" if several and self.cluster == "slurm" else "*")
        lines.append(f"output: {logs}_log.out, {logs}_log.err")
        if self.cluster == "slurm":
            lines.append(f"state: squeue --jobs {self.array}; stop: scancel {self.array}")
        else:
            lines.append(f"state: tail {self.logs}/*_log.err; the jobs are processes, which "
                         "outlive this command")
        lines.append("to continue what has ended early, submit the same command again")
        return "\n".join(lines)


def submit_shards(command: Sequence[str], config: SubmitConfig) -> Submission:
    """Hand over a command of gcbench as jobs, each with one shard.

    Args:
        command: The command and its options, without --shard.
        config: How they run.

    Raises:
        ConfigError: If an option is wrong, the command has no shards, or submitit is missing.
        RenderError: If the scheduler takes no job.
    """
    _check(command, config)
    require_local(config.logs, "--logs")
    options = list(command)
    if not any(word.partition("=")[0] == "--workers" for word in options):
        options += ["--workers", str(config.cpus)]
    executor = _open_executor(config)
    if executor.cluster == "local" and config.parallel:
        raise ConfigError("--parallel is for Slurm; the local executor starts all shards at once")
    try:
        executor.update_parameters(**_parameters(config, command[0]))
        job = ShardJob(tuple(options), config.shards)
        with redirect_stderr(io.StringIO()):  # it prints the error that it raises
            jobs = executor.map_array(job, range(config.shards))
    except _refusals() as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise RenderError(f"{executor.cluster} takes no job: {said}") from error
    return Submission(jobs, executor.cluster, config.logs)


def _check(command: Sequence[str], config: SubmitConfig) -> None:
    """Raises ConfigError for a command without shards, and for numbers out of range."""
    name = command[0] if command else ""
    if name not in SHARDED:
        raise ConfigError(f"submit has no command {name!r}{suggestion(name, SHARDED)}; "
                          f"there are {', '.join(SHARDED)}")
    given = [word.partition("=")[0] for word in command]
    if "--shard" in given:
        raise ConfigError("submit gives each job its --shard; leave it out")
    for option in _ALONE.get(name, ()):
        if option in given:
            raise ConfigError(f"submit gives each job its --shard, which excludes {option}; leave "
                              f"{option} out")
    if not 1 <= config.shards <= _MOST:
        raise ConfigError(f"--shards {config.shards}: give 1 to {_MOST}")
    if min(config.cpus, config.time) < 1 or min(config.gpus, config.parallel) < 0:
        raise ConfigError("--cpus and --time must be 1 or more, --gpus and --parallel 0 or more")
    for text in config.slurm:
        if not re.fullmatch(r"[a-z][a-z-]*=[^\n]+", text, re.ASCII):
            raise ConfigError(f"--slurm {text[:60]!a}: give NAME=VALUE, such as account=robots")


def _open_executor(config: SubmitConfig) -> AutoExecutor:
    try:
        import submitit
    except ImportError as error:
        raise ConfigError(
            f"gcbench submit needs {error.name}: pip install '.[cluster]'") from error
    cluster = None if config.executor == "auto" else config.executor
    try:
        config.logs.mkdir(parents=True, exist_ok=True)
        return submitit.AutoExecutor(
            config.logs, cluster, slurm_max_num_timeout=_REQUEUES, local_max_num_timeout=_REQUEUES)
    except RuntimeError as error:  # no srun
        raise ConfigError("there is no Slurm on this machine (no srun); submit from a login "
                          "node, or with --executor local") from error


def _parameters(config: SubmitConfig, name: str) -> dict[str, Any]:
    """What submitit is told."""
    given = dict(text.split("=", 1) for text in config.slurm)
    return {
        "name": f"gcbench-{name}", "timeout_min": config.time, "cpus_per_task": config.cpus,
        "gpus_per_node": config.gpus or None, "slurm_partition": config.partition or None,
        "slurm_array_parallelism": config.parallel or config.shards,
        "slurm_srun_args": [f"--cpus-per-task={config.cpus}"],  # Slurm 22.05 does not inherit it
        "slurm_wckey": "gcbench", "slurm_additional_parameters": {"requeue": True, **given},
    }


def _refusals() -> tuple[type[Exception], ...]:
    """What submitit raises when there is no job."""
    from submitit.core.utils import FailedJobError

    return FailedJobError, OSError
