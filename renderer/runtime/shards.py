"""Sequences for many processes: each renders its own share of one dataset."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from ...errors import ConfigError

_SCHEDULERS = (
    ("SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_COUNT"),
    ("AWS_BATCH_JOB_ARRAY_INDEX", "AWS_BATCH_JOB_ARRAY_SIZE"),
    ("JOB_COMPLETION_INDEX", ""),  # Kubernetes tells no number of jobs
    ("RANK", "WORLD_SIZE"),
)
"""Variables in which a scheduler tells a job its index, and the number of jobs."""


@dataclass(frozen=True)
class Shard(Collection[int]):
    """The sequences `index`, `index + count`, ... of a dataset of n.

    Processes may render the shards of one dataset at the same time, also on several machines that
    share its folder. Shards interleave: when all stop early, the dataset has no large gaps.

    Args:
        n: Number of sequences in the dataset.
        index: Number of the shard, 0 to `count` - 1.
        count: Number of shards.

    Raises:
        ConfigError: If a number is out of range.

    Example:
        >>> list(gb.Shard(n=10, index=1, count=4))
        [1, 5, 9]
    """

    n: int
    index: int
    count: int

    def __post_init__(self) -> None:
        if self.n < 1 or not 0 <= self.index < self.count:
            raise ConfigError(f"shard {self.index}/{self.count} of {self.n} sequences: give 1 or "
                              "more sequences, and shards 0/N to N-1/N")

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.index, self.n, self.count))

    def __len__(self) -> int:
        return len(range(self.index, self.n, self.count))

    def __contains__(self, number: object) -> bool:
        return number in range(self.index, self.n, self.count)


def parse_shard(text: str, n: int) -> Shard:
    """Return the shard that `--shard` names: 3/64, auto, or auto/64.

    `auto` reads the index, and the number of shards if it is not given, from the variables of
    Slurm, AWS Batch, Kubernetes or torchrun.

    Raises:
        ConfigError: If the text is none of these, or there are no such variables.
    """
    if match := re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII):
        return Shard(n, int(match[1]), int(match[2]))
    if not (match := re.fullmatch(r"auto(?:/(\d{1,9}))?", text, re.ASCII)):
        raise ConfigError(f"--shard {text[:60]!a}: give INDEX/COUNT, such as 3/64, or auto")
    for index, count in _SCHEDULERS:
        if index in os.environ:
            return Shard(n, *_own_share(index, count, int(match[1] or 0)))
    names = ", ".join(index for index, _ in _SCHEDULERS)
    raise ConfigError(f"--shard {text}: no scheduler has set one of {names}; give INDEX/COUNT")


def _own_share(name: str, of_count: str, given: int) -> tuple[int, int]:
    """The index in a variable, and the number of shards: `given`, or (if 0) in another variable.

    An array of Slurm may start at 1, and have steps. Part of an array that is queued again has
    other variables than the whole, from which its shards cannot be told.
    """
    count = given or _number(of_count)
    if not name.startswith("SLURM"):
        return _number(name), count

    def read(end: str, default: int) -> int:
        variable = f"SLURM_ARRAY_TASK_{end}"
        return _number(variable) if variable in os.environ else default

    first, step, tasks = read("MIN", 0), max(1, read("STEP", 1)), read("COUNT", count)
    last = read("MAX", first + (count - 1) * step)
    if first > 1 or tasks != count or last != first + (count - 1) * step:
        raise ConfigError(
            f"--shard auto: tasks {first} to {last} ({tasks} in all) are not an array of {count} "
            f"shards; to repeat a part of an array, give --shard ${name}/COUNT, with the COUNT of "
            "the whole array")
    return (_number(name) - first) // step, count


def _number(name: str) -> int:
    text = os.environ.get(name, "")
    if not text:
        raise ConfigError("--shard auto: the number of shards is unknown; give auto/COUNT")
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII):
        raise ConfigError(f"--shard auto: {name} is {text[:20]!a}, no number")
    return int(text)
