"""Wait until all shards of a submission have ended, and tell which failed."""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import printable
from ..runtime import say, shard_bar
from .submission import Submission

if TYPE_CHECKING:
    from submitit import Job

_EVERY = {"slurm": 5.0, "local": 0.2}  # s
_LAST_LINES, _LAST_BYTES = 5, 4000
_LOOKS = 3
"""Looks at a job that has gone without a result, before it counts as failed."""
_SHOWN = 3  # failed shards


def wait_for_shards(submission: Submission, progress: bool = True) -> str:
    """Wait until all shards have ended.

    Returns:
        The failed shards with the last lines of their output; empty if none failed.
    """
    jobs = submission.jobs
    left, failed, missed = {*range(len(jobs))}, list[int](), Counter[int]()
    with shard_bar(len(jobs), progress) as bar, _jobs_go_on(submission):
        while True:
            alive = _alive(submission)
            for index in sorted(left):
                if _has_succeeded(jobs[index]):
                    left.discard(index)
                elif alive is not None and jobs[index].job_id not in alive:
                    missed[index] += 1  # a shared folder may show a result late
                    if missed[index] >= _LOOKS:
                        left.discard(index)
                        failed.append(index)
            running = sum((alive or {}).get(jobs[index].job_id) == "RUNNING" for index in left)
            notes = [f"{running} running"] + [f"{len(failed)} failed"] * bool(failed)
            bar.set_postfix_str(", ".join(notes), refresh=False)
            bar.update(len(jobs) - len(left) - bar.n)
            if sys.stderr.isatty():
                bar.refresh()
            if not left:
                return _describe_failures(submission, sorted(failed))
            time.sleep(_EVERY[submission.cluster])


@contextmanager
def _jobs_go_on(submission: Submission) -> Generator[None]:
    """Ctrl-C ends the waiting only; processes of this machine get the signal too."""
    try:
        yield
    except KeyboardInterrupt:
        if submission.cluster == "slurm":
            say(f"the jobs go on; scancel {submission.array} stops them")
        raise


def _alive(submission: Submission) -> dict[str, str] | None:
    """The state of each job that has not ended; None if the scheduler does not answer."""
    if submission.cluster == "local":
        return {job.job_id: job.state for job in submission.jobs if job.state == "RUNNING"}
    asked = subprocess.run(
        ["squeue", "--noheader", "--array", "--format=%F_%K %T", "--jobs", submission.array],
        capture_output=True, text=True,
    )
    if asked.returncode:  # the scheduler forgets jobs that have ended
        return {} if "Invalid job id" in asked.stderr else None
    return {name.removesuffix("_N/A"): state
            for name, state in map(str.split, asked.stdout.splitlines())}


def _has_succeeded(job: Job[None]) -> bool:
    return job.paths.result_pickle.exists() and job.exception() is None


def _describe_failures(submission: Submission, failed: list[int]) -> str:
    lines: list[str] = []
    for index in failed[:_SHOWN]:
        job, log = submission.jobs[index].job_id, submission.log(index)
        lines.append(f"shard {index}/{len(submission.jobs)} (job {job}) failed; {log} ends with:")
        lines += [f"  {printable(line)}" for line in _last_lines(log)]
    if len(failed) > _SHOWN:
        others = ", ".join(map(str, failed[_SHOWN:]))
        lines.append(f"{len(failed) - _SHOWN} more shards failed: {others}")
    return "\n".join(lines)


def _last_lines(log: Path) -> list[str]:
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - _LAST_BYTES))
            text = file.read().decode(errors="replace")
    except OSError as error:
        return [f"(cannot be read: {error.strerror})"]
    return text.strip().splitlines()[-_LAST_LINES:]
