"""What runs in a job: a command of gcbench on one shard."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..runtime import die_with_parent

if TYPE_CHECKING:
    from submitit.helpers import DelayedSubmission


@dataclass(frozen=True)
class ShardJob:
    """`gcbench COMMAND ... --shard k/N`; submitit calls it in the job."""

    command: tuple[str, ...]
    """The command and its options, without --shard."""
    count: int
    """Number of shards."""

    def __call__(self, index: int) -> None:
        """Run the command on a shard; end as it ends, with no traceback, if it fails."""
        shard = f"{index}/{self.count}"
        done = subprocess.run(
            [sys.executable, "-m", "gcbench", *self.command, "--shard", shard],
            preexec_fn=_prepare_command,
        )
        if done.returncode:
            raise SystemExit(abs(done.returncode))

    def checkpoint(self, index: int) -> DelayedSubmission:
        """What the job does after it is queued again: the same, which continues the shard."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self, index)


def _prepare_command() -> None:
    """Leave the scheduler's signals to the job, which ends the command in time.

    Slurm sends them to every process of a job; they would end the command as a failure.
    """
    for number in (signal.SIGTERM, signal.SIGUSR2):
        signal.signal(number, signal.SIG_IGN)
    die_with_parent()
