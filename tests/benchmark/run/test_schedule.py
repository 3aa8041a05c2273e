"""The plan of an evaluation, its order, and the time that is left."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
from gcbench.__main__ import main
from gcbench.benchmark.results.estimates import Stored
from gcbench.benchmark.results.rows import Row
from gcbench.benchmark.results.runs import find_runs
from gcbench.benchmark.run.datasets import from_folders
from gcbench.benchmark.run.jobs import Job, describe_run, prepare_job
from gcbench.benchmark.run.schedule import Clock, cheap_first, describe_plan, interleave

from ...support import bench_data

METHODS = Path(__file__).parents[2] / "support/bad_methods.py"
RGB = Row("gcpose", "1", "rgb", "axes", "none")
RGBD = dataclasses.replace(RGB, inputs="rgbd")
FOREIGN = dataclasses.replace(RGB, method="theirs")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bench_data.make_dataset(tmp_path_factory.mktemp("data") / "arm", 3)


@pytest.fixture
def jobs(folder: Path, tmp_path: Path) -> list[Job]:
    (data,) = from_folders([folder])
    return [prepare_job(describe_run(row, row.name, data, {}), data, tmp_path)
            for row in (FOREIGN, RGB, RGBD)]


def test_an_unfinished_dataset_is_evaluated_with_a_warning(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    info = json.loads((copy / "dataset.json").read_text())
    (copy / "dataset.json").write_text(json.dumps(info | {"counts": None}))
    assert [data.name for data in from_folders([folder, copy])] == ["arm", "copy"]
    assert capsys.readouterr().err == (
        f"gcbench: {copy} is not finished (its run has not ended); run the same gcbench render "
        "command again\n")


def test_cheap_rows_run_first_and_each_row_is_tried_first(jobs: list[Job]) -> None:
    foreign, rgb, rgbd = jobs
    assert cheap_first(jobs) == [rgbd, rgb, foreign]
    order = interleave([rgbd, rgb])
    assert order == [(rgbd, "000000"), (rgb, "000000"), (rgbd, "000001"), (rgbd, "000002"),
                     (rgb, "000001"), (rgb, "000002")]


def test_the_plan_names_the_time_of_known_methods(jobs: list[Job]) -> None:
    foreign, rgb, rgbd = jobs
    expected = 3 * (4 * (1.2 + 0.2) + 0.4)  # 3 sequences of 4 frames
    assert 17 < expected < 21
    assert describe_plan([rgbd, rgb], 1).startswith("plan: 2 rows x 3 sequences, about 20 s; the ")
    assert describe_plan([foreign], 1) == (
        "plan: 1 row x 3 sequences, the time left shows after one sequence of each row")
    assert "more than 20 s" in describe_plan(jobs, 1)
    assert "stream train" not in describe_plan([rgb], 1)
    done = dataclasses.replace(rgb, todo=())
    assert describe_plan([done], 1) == "plan: 1 row x 3 sequences, 3 of 3 estimates exist"


def test_the_plan_says_that_a_method_may_have_learned_from_the_data(tmp_path: Path) -> None:
    (data,) = from_folders([bench_data.make_dataset(tmp_path / "arm", 1, stream="train")])
    for training, said in (("none", False), ("supervised: depth video of arms", True)):
        row = dataclasses.replace(FOREIGN, training=training)
        job = prepare_job(describe_run(row, row.name, data, {}), data, tmp_path / training[:4])
        assert ("arm is of the stream train: a method that has" in describe_plan([job], 1)) == said


@pytest.mark.parametrize(("flow", "seconds"), [("raft", 15), ("dis-fine", 10)])
def test_the_plan_knows_options_that_take_less_time(
    folder: Path, tmp_path: Path, flow: str, seconds: int
) -> None:
    (data,) = from_folders([folder])
    row = dataclasses.replace(RGB, method=f"gcpose flow={flow}")
    job = prepare_job(describe_run(row, row.name, data, {}), data, tmp_path)
    assert f"about {seconds} s" in describe_plan([job], 1)


def test_the_time_left_follows_the_times_of_each_row(jobs: list[Job]) -> None:
    foreign, _, rgbd = jobs
    clock = Clock(1, [foreign, rgbd])
    clock.count(foreign, Stored("ok", seconds=60.0), 61.0)
    assert clock.remaining_time() == "about 2 min"
    clock.count(foreign, Stored("timeout"), 300.0)
    assert clock.remaining_time() == "about 3 min"
    clock.count(foreign, Stored("ok", seconds=60.0), 61.0)
    for _ in range(3):
        clock.count(rgbd, Stored("ok", seconds=1.0), 1.0)
    assert clock.remaining_time() == ""


def test_the_default_is_axes_and_a_limit_is_kept(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["eval", "--method", f"{METHODS}:Levels", "--data", str(folder), "--limit", "2",
               "--results", str(tmp_path / "results"), "--workers", "1"]
    assert main(command) == 0
    captured = capsys.readouterr()
    assert captured.err.startswith("plan: 2 rows x 2 sequences, the time left shows after one")
    assert captured.out.splitlines()[-1] == str(tmp_path / "results/report/index.html")
    runs = [f.run for f in find_runs(tmp_path / "results")]
    assert [(r.row.inputs, r.row.knowledge) for r in runs] == [("rgb", "axes"), ("rgbd", "axes")]
    assert all(run.sequences == ("000000", "000001") for run in runs)
    assert main([*command, "--knowledge", "all", "--limit", "0"]) == 0
    runs = [f.run for f in find_runs(tmp_path / "results")]
    assert len(runs) == 4
    assert all(len(run.sequences) == 3 for run in runs)


def test_sequences_are_chosen_by_number(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["eval", "--method", "hold-still", "--data", str(folder),
               "--results", str(tmp_path / "results"), "--sequences"]
    assert main([*command, "1-2"]) == 0
    (run,) = (f.run for f in find_runs(tmp_path / "results"))
    assert run.sequences == ("000001", "000002")
    assert main([*command, "2,0", "--limit", "1"]) == 0
    (run,) = (f.run for f in find_runs(tmp_path / "results"))
    assert run.sequences == ("000002",)
    capsys.readouterr()
    for wrong, said in (("0,7", f"{folder} has no sequence 7"), ("a", "give numbers and ranges")):
        assert main([*command, wrong]) == 2
        assert said in capsys.readouterr().err


def test_the_exit_code_is_1_if_nothing_was_estimated(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["eval", "--method", f"{METHODS}:AlwaysRaises", "--data", str(folder),
               "--results", str(tmp_path / "results")]
    assert main(command) == 1
    assert "gcbench: no sequence was estimated" in capsys.readouterr().err
    assert main([*command, "--method", "hold-still"]) == 0
