"""A command of gcbench as jobs: what they leave is what one run leaves."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest
from gcbench import ConfigError
from gcbench.__main__ import main
from gcbench.renderer.cluster.shard_job import ShardJob
from gcbench.renderer.cluster.submission import SubmitConfig, submit_shards

from ...support import bench_data
from ...support.fake_results import read_results
from ...support.slurm import find_daemons, start_slurm
from ..generate.test_generate import content, is_alone, until

RENDER = ["render", "--robot", "owi535", "--frames", "2", "--width", "64", "--height", "48"]
N = 96
"""More than two shards render in the 3 s that Slurm gives a job to end."""
KILLED = """
import sys
from gcbench.renderer.cluster.shard_job import ShardJob
ShardJob(("render", "--robot", "owi535", "--n", "500", "--out", sys.argv[1]), 1)(0)
"""
needs_submitit = pytest.mark.skipif(
    not importlib.util.find_spec("submitit"), reason="no submitit: pip install '.[cluster]'")


def submit(*args: str, environment: dict[str, str] | None = None) -> subprocess.Popen[str]:
    """Run `gcbench submit` in a process of its own, as the jobs outlive it."""
    return subprocess.Popen([sys.executable, "-m", "gcbench", "submit", *args], text=True,
                            env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


# -- the options ------------------------------------------------------------------------------


SLURM = SubmitConfig(executor="slurm")
"""Not of this machine, where jobs would begin at once."""


@pytest.mark.parametrize(("command", "config", "message"), [
    ([], SubmitConfig(), "no command ''; there are render, eval, verify"),
    (["rander"], SubmitConfig(), "no command 'rander'.*render"),
    (["render", "--shard", "0/2"], SubmitConfig(), "gives each job its --shard; leave it out"),
    (["render", "--sequences", "0-9"], SLURM, "excludes --sequences; leave --sequences"),
    (["verify", "data", "--sequences=0-9"], SLURM, "excludes --sequences; leave"),
    (["verify", "data", "--merge"], SLURM, "excludes --merge; leave --merge out"),
    (["render"], SubmitConfig(shards=0), "--shards 0: give 1 to"),
    (["render"], SubmitConfig(cpus=0), "--cpus and --time must be 1 or more"),
    (["render"], SubmitConfig(slurm=("account",)), "give NAME=VALUE, such as account=robots"),
    (["render"], SubmitConfig(slurm=("a=b\n#SBATCH --x",)), "give NAME=VALUE"),
])  # fmt: skip
def test_wrong_options_are_one_line(
    command: list[str], config: SubmitConfig, message: str
) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        submit_shards(command, config)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("args", "message"), [
    (["--shards", "2"], "give a command after --"),
    (["--shards", "2", "--", "render", "--width", "x"], "gcbench render --help"),
    (["--", "render", "--robot", "no-robot-of-this-name"], "no-robot-of-this-name"),
])
def test_a_wrong_command_is_refused_before_the_queue(
    args: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["submit", "--logs", str(tmp_path / "logs"), *args]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "logs").exists()


def test_without_submitit_the_error_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(ConfigError, match=r"needs submitit: pip install '\.\[cluster\]'"):
        submit_shards(["render"], SubmitConfig(logs=tmp_path))


def test_a_command_that_fails_ends_the_job_with_its_code(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        ShardJob(("render", "--shard-of-nothing"), 4)(3)
    assert caught.value.code == 2
    assert "Traceback" not in capfd.readouterr().err


def test_a_job_that_is_killed_leaves_no_command(tmp_path: Path) -> None:
    job = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)], start_new_session=True)
    assert until((tmp_path / ".lock").exists, 60)
    job.kill()
    job.wait()
    assert until(lambda: is_alone(job.pid))


# -- processes of this machine ----------------------------------------------------------------


@needs_submitit
@pytest.mark.gl
@pytest.mark.ci
def test_jobs_of_this_machine_make_what_one_run_makes(tmp_path: Path) -> None:
    """The same submission again finds nothing to do."""
    out, alone = tmp_path / "out", tmp_path / "alone"
    options = ["--executor", "local", "--shards", "2", "--cpus", "1", "--wait", "--json", "--quiet",
               "--logs", str(tmp_path / "logs"), "--", *RENDER, "--n", "3", "--out", str(out)]
    job = submit(*options)
    assert main([*RENDER, "--n", "3", "--out", str(alone), "--workers", "1", "--quiet"]) == 0
    said, errors = job.communicate(timeout=120)
    record = json.loads(said)
    assert (job.returncode, record["ok"], record["cluster"]) == (0, True, "local"), errors
    assert content(out) == content(alone)
    for name in record["jobs"]:
        assert "rendered in" in (tmp_path / f"logs/{name}_0_log.out").read_text()


@needs_submitit
def test_a_shard_that_fails_is_told_with_its_last_lines(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    job = submit("--executor", "local", "--shards", "1", "--wait", "--logs", str(tmp_path / "logs"),
                 "--", *RENDER, "--out", str(tmp_path / "file"))
    said, errors = job.communicate(timeout=120)
    assert job.returncode == 1
    assert "not all well" in said and "shard 0/1" in errors
    assert "  gcbench: " in errors and str(tmp_path / "file") in errors.splitlines()[-1]
    assert "Traceback" not in errors


# -- a real Slurm -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Generator[dict[str, str]]:
    pytest.importorskip("submitit")
    if reason := find_daemons():
        pytest.skip(reason)
    with start_slurm(tmp_path_factory.mktemp("slurm")) as environment:
        yield environment


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("expected") / "out"
    assert main([*RENDER, "--n", str(N), "--out", str(out), "--workers", "1", "--quiet"]) == 0
    return out


@pytest.fixture(scope="module")
def expected(data: Path) -> dict[str, str]:
    return content(data)


def interrupt(slurm: dict[str, str], folder: Path, shards: int, *command: str) -> list[str]:
    """Submit, run a command when every shard has begun, and return the output of the jobs."""
    logs, out = folder / "logs", folder / "out"
    waiting = submit("--shards", str(shards), "--cpus", "1", "--wait", "--logs", str(logs), "--",
                     *RENDER, "--n", str(N), "--out", str(out), environment=slurm)
    begun = lambda: {int(p.stem) % shards for p in out.glob("sequences/[!.]*.zip")}  # noqa: E731
    assert until(lambda: len(begun()) == shards, 240)
    assert len(list(out.glob("sequences/[!.]*.zip"))) < N
    array = min(logs.glob("*_submitted.pkl")).name.partition("_")[0]
    subprocess.run([word.format(array) for word in command], env=slurm, check=True, timeout=120)
    said, errors = waiting.communicate(timeout=400)
    assert (waiting.returncode, said.strip()) == (0, f"{shards} shards have ended"), errors
    return [log.read_text() for log in sorted(logs.glob("*_log.out"))]


@pytest.mark.slow
@pytest.mark.gl
def test_pre_empted_jobs_make_what_one_run_makes(
    slurm: dict[str, str], tmp_path: Path, expected: dict[str, str]
) -> None:
    outputs = interrupt(slurm, tmp_path, 2, "srun", "--partition=urgent", "--cpus-per-task",
                        str(os.cpu_count()), "true")
    assert [text.count("Loading pickle") for text in outputs] == [2, 2]
    assert content(tmp_path / "out") == expected


@pytest.mark.slow
@pytest.mark.gl
def test_a_job_near_its_time_limit_is_queued_again(
    slurm: dict[str, str], tmp_path: Path, expected: dict[str, str]
) -> None:
    output, = interrupt(slurm, tmp_path, 1, "scancel", "--signal=USR2", "{}")
    assert "Caught signal SIGUSR2" in output and output.count("Loading pickle") == 2
    assert content(tmp_path / "out") == expected


@pytest.mark.slow
@pytest.mark.gl
def test_shards_of_eval_and_verify_are_jobs(
    slurm: dict[str, str], tmp_path: Path, data: Path
) -> None:
    """Together they do what one run does."""
    arm, logs = bench_data.make_dataset(tmp_path / "arm", 4), tmp_path / "logs"
    estimate = ["eval", "--method", "hold-still", "--data", str(arm), "--results"]
    verify = ["verify", str(data), "--reports", str(tmp_path / "reports")]
    for command in ([*estimate, str(tmp_path / "results")], verify):
        job = submit("--shards", "2", "--cpus", "1", "--wait", "--logs", str(logs), "--", *command,
                     environment=slurm)
        said, errors = job.communicate(timeout=400)
        assert (job.returncode, said.strip()) == (0, "2 shards have ended"), errors
    assert main([*estimate, str(tmp_path / "alone"), "--quiet"]) == 0
    shards, alone = (
        [r for path in (tmp_path / name).rglob("scores.csv") for r in read_results(path) if r.joint]
        for name in ("results", "alone"))
    assert shards == alone and shards
    assert main([*verify, "--merge", "--quiet"]) == 0


@pytest.mark.slow
def test_a_job_of_slurm_that_fails_is_told(slurm: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    job = submit("--shards", "2", "--cpus", "1", "--wait", "--logs", str(tmp_path / "logs"),
                 "--", *RENDER, "--out", str(tmp_path / "file"), environment=slurm)
    said, errors = job.communicate(timeout=240)
    assert job.returncode == 1 and "not all well" in said
    assert errors.count("failed; ") == 2 and "gcbench: " in errors and "squeue --jobs" in errors


@pytest.mark.slow
def test_what_slurm_refuses_is_one_line(slurm: dict[str, str], tmp_path: Path) -> None:
    job = submit("--partition", "nowhere", "--logs", str(tmp_path / "logs"), "--", *RENDER,
                 environment=slurm)
    said, errors = job.communicate(timeout=120)
    assert (job.returncode, said) == (2, "")
    assert errors.startswith("gcbench: slurm takes no job: ") and "partition" in errors
    assert errors.count("\n") == 1
