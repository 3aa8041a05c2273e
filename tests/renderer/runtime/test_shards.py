"""Shards: shares of a dataset, and what schedulers say of them."""

from __future__ import annotations

import os

import pytest
from gcbench import ConfigError, Shard
from gcbench.renderer.runtime.shards import parse_shard


def test_shards_are_disjoint_and_complete() -> None:
    shards = [Shard(10, k, 4) for k in range(4)]
    assert sorted(i for shard in shards for i in shard) == list(range(10))
    assert list(shards[1]) == [1, 5, 9] and len(shards[1]) == 3
    assert 5 in shards[1] and 6 not in shards[1] and 13 not in shards[1]
    assert len(Shard(2, 3, 4)) == 0
    for wrong in ((0, 0, 1), (5, 4, 4), (5, -1, 4), (5, 0, 0)):
        with pytest.raises(ConfigError, match="give 1 or more sequences, and shards 0/N to N-1/N"):
            Shard(*wrong)


@pytest.fixture
def _no_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in os.environ:
        if name.startswith(("SLURM_", "AWS_BATCH_", "JOB_COMPLETION", "RANK", "WORLD_SIZE")):
            monkeypatch.delenv(name)


def slurm(index: int, first: int, last: int, tasks: int) -> dict[str, str]:
    """The variables of a task of an array."""
    values = {"ID": index, "MIN": first, "MAX": last, "COUNT": tasks, "STEP": 1}
    return {f"SLURM_ARRAY_TASK_{name}": str(value) for name, value in values.items()}


@pytest.mark.usefixtures("_no_scheduler")
@pytest.mark.parametrize(("variables", "text", "index", "count"), [
    ({}, "3/64", 3, 64),
    ({"RANK": "9", "WORLD_SIZE": "10"}, "3/64", 3, 64),
    ({"SLURM_ARRAY_TASK_ID": "4", "SLURM_ARRAY_TASK_COUNT": "8"}, "auto", 4, 8),
    ({"SLURM_ARRAY_TASK_ID": "7", "SLURM_ARRAY_TASK_COUNT": "4", "SLURM_ARRAY_TASK_MIN": "1",
      "SLURM_ARRAY_TASK_STEP": "2"}, "auto", 3, 4),
    (slurm(8, 1, 8, 8), "auto/8", 7, 8),
    ({"AWS_BATCH_JOB_ARRAY_INDEX": "0", "AWS_BATCH_JOB_ARRAY_SIZE": "2"}, "auto", 0, 2),
    ({"JOB_COMPLETION_INDEX": "5"}, "auto/6", 5, 6),
    ({"RANK": "1", "WORLD_SIZE": "2"}, "auto", 1, 2),
])
def test_schedulers_say_the_shard(
    variables: dict[str, str], text: str, index: int, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert parse_shard(text, 100) == Shard(100, index, count)


@pytest.mark.usefixtures("_no_scheduler")
@pytest.mark.parametrize(("variables", "text", "message"), [
    ({}, "3", "give INDEX/COUNT, such as 3/64, or auto"),
    ({}, "64/64", "shards 0/N to N-1/N"),
    ({}, "auto", "no scheduler has set one of SLURM_ARRAY_TASK_ID"),
    ({"JOB_COMPLETION_INDEX": "5"}, "auto", "number of shards is unknown; give auto/COUNT"),
    ({"RANK": "x", "WORLD_SIZE": "2"}, "auto", "RANK is 'x', no number"),
    ({"RANK": "3", "WORLD_SIZE": "2"}, "auto", "shard 3/2"),
    (slurm(5, 5, 6, 2), "auto/8", r"tasks 5 to 6 \(2 in all\) are not an array of 8 shards;"),
    (slurm(5, 5, 5, 1), "auto", r"give --shard \$SLURM_ARRAY_TASK_ID/COUNT"),
    (slurm(7, 0, 7, 2), "auto", "are not an array of 2 shards"),
])
def test_wrong_shards_are_one_line(
    variables: dict[str, str], text: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=message) as caught:
        parse_shard(text, 10)
    assert "\n" not in str(caught.value)
