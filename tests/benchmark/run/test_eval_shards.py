"""Many processes evaluate one row: its scores are those of one process."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from gcbench import ConfigError, DatasetError, EvalConfig, evaluate, report
from gcbench.benchmark.report.leaderboard import build_leaderboard
from gcbench.benchmark.results.rows import COLUMNS
from gcbench.benchmark.results.runs import Results, find_runs, read_run, write_run

from ...renderer.generate.test_generate import until
from ...support import bench_data

METHOD = f"{Path(__file__).parents[2] / 'support/bad_methods.py'}:Reads"
N = 5
_OF_MACHINE = ("seconds", "seconds_per_frame", "peak_memory")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bench_data.make_dataset(tmp_path_factory.mktemp("data") / "arm", N)


@pytest.fixture(scope="module")
def expected(data: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    return scores(evaluate(config(data, tmp_path_factory.mktemp("alone")), progress=False))


def config(data: Path, results: Path, shard: str = "", **changes: object) -> EvalConfig:
    plain = EvalConfig((METHOD,), data=(data,), workers=1, results=results, shard=shard)
    return dataclasses.replace(plain, **changes)  # type: ignore[arg-type]


def scores(results: Results) -> str:
    """The table of the only run, without what the machine decides."""
    (run,) = results.runs
    lines = (run.path / "scores.csv").read_text().splitlines()
    metric = COLUMNS.index("metric")
    return "\n".join(line for line in lines if line.split(",")[metric] not in _OF_MACHINE)


def start(data: Path, results: Path, shard: str, *more: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "gcbench", "eval", "--method", METHOD, "--data", str(data),
         "--results", str(results), "--workers", "1", "--shard", shard, *more],
        text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)


@pytest.mark.ci
def test_shards_make_the_scores_of_one_run(data: Path, tmp_path: Path, expected: str) -> None:
    for k, (mine, there) in enumerate([(2, 2), (2, 4)]):
        found = evaluate(config(data, tmp_path, f"{k}/3"), progress=False)
        assert (found.estimated, found.usable, found.runs) == (mine, mine, ())
        assert found.unfinished == (
            f"reads (rgbd, axes) on arm: {there} of {N} sequences are estimated",)
    assert not list(tmp_path.glob("**/scores.csv"))
    with pytest.raises(DatasetError, match=r"no scores in .*4 of 5 sequences estimated and none"):
        report(tmp_path, tmp_path / "report", progress=False)
    last = evaluate(config(data, tmp_path, "2/3"), progress=False)
    assert (last.estimated, last.unfinished) == (1, ()) and scores(last) == expected
    again = evaluate(config(data, tmp_path, "0/3"), progress=False)
    assert again.estimated == 0 and scores(again) == expected


def test_a_run_without_shards_completes_the_row(data: Path, tmp_path: Path, expected: str) -> None:
    evaluate(config(data, tmp_path, "1/2"), progress=False)
    found = evaluate(config(data, tmp_path), progress=False)
    assert found.estimated == N - 2 and scores(found) == expected


@pytest.mark.ci
def test_a_killed_shard_continues_beside_another(
    data: Path, tmp_path: Path, expected: str
) -> None:
    other, killed = start(data, tmp_path, "0/2", "--quiet"), start(data, tmp_path, "1/2")
    assert until(lambda: list(tmp_path.glob("*/arm/estimates/000001.zip")), 120)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.communicate()
    again = start(data, tmp_path, "1/2", "--quiet")
    for process in (other, again):
        said, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
        assert "reads" in said
    (run,) = find_runs(tmp_path)
    assert scores(Results((run,))) == expected
    assert not (tmp_path / "report").exists()
    assert not list(tmp_path.glob("**/.*.tmp"))


def test_more_shards_than_sequences_is_no_failure(data: Path, tmp_path: Path) -> None:
    idle = start(data, tmp_path, f"{N}/{N + 1}", "--json")
    said, errors = idle.communicate(timeout=120)
    assert (idle.returncode, errors.count("no sequence was estimated")) == (0, 0), errors
    assert '"estimated": 0' in said and f"0 of {N} sequences are estimated" in said


def test_what_is_there_is_not_taken_for_another_dataset(data: Path, tmp_path: Path) -> None:
    evaluate(config(data, tmp_path, "0/2"), progress=False)
    (run,) = find_runs(tmp_path)
    write_run(run.path, dataclasses.replace(
        run.run, row=dataclasses.replace(run.run.row, version="0")))
    with pytest.raises(DatasetError, match=r"version: .*--retry ok without --shard"):
        evaluate(config(data, tmp_path, "1/2"), progress=False)
    with pytest.raises(ConfigError, match="--retry ok and --shard exclude each other"):
        evaluate(config(data, tmp_path, "1/2", retry=("ok",)), progress=False)


def test_a_growing_row_is_scored_when_it_is_whole(
    data: Path, tmp_path: Path, expected: str
) -> None:
    evaluate(config(data, tmp_path, limit=3), progress=False)
    for k in (0, 1):
        found = evaluate(config(data, tmp_path, f"{k}/2"), progress=False)
        assert bool(found.runs) == (k == 1)
    assert scores(found) == expected
    assert len(read_run(found.runs[0].path / "run.json").sequences) == N


def test_a_damaged_estimate_is_made_again_by_its_shard(data: Path, tmp_path: Path) -> None:
    alone = evaluate(config(data, tmp_path), progress=False)
    before = scores(alone)
    alone.runs[0].estimate_path("000002").write_bytes(b"damaged")
    with pytest.raises(DatasetError, match=r"000002\.zip"):
        evaluate(config(data, tmp_path, "1/2"), progress=False)  # 1 and 3
    found = evaluate(config(data, tmp_path, "0/2"), progress=False)
    assert found.estimated == 1 and scores(found) == before


def test_scores_of_a_part_are_not_ranked(data: Path, tmp_path: Path) -> None:
    found = evaluate(config(data, tmp_path), progress=False)
    table = found.runs[0].path / "scores.csv"
    table.write_text("".join(line for line in table.read_text().splitlines(keepends=True)
                             if ",000004," not in line))
    board = build_leaderboard(found.runs)
    assert board.ranks == (0,)
    assert board.labels == [f"reads · rgbd · axes · {N - 1} of {N} sequences"]


@pytest.mark.slow
def test_actors_of_ray_make_the_scores_of_one_run(
    data: Path, tmp_path: Path, expected: str
) -> None:
    """Their records have no estimates; the files of the actors do."""
    pytest.importorskip("ray")
    command = [sys.executable, "-m", "gcbench", "eval", "--method", METHOD, "--data", str(data),
               "--results", str(tmp_path), "--executor", "ray", "--address", "local", "--workers",
               "2"]
    for _ in range(2):  # the second finds all estimates
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        (folder,) = find_runs(tmp_path)
        assert scores(Results((folder,))) == expected
    assert folder.run.limits["workers"] == 2
