"""Workers of a real Ray cluster make what the processes of one machine make, whatever dies."""

from __future__ import annotations

import importlib.util
import os
import random
import re
import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from gcbench import ConfigError, RayWorkers, RenderError
from gcbench.__main__ import main
from gcbench.renderer.cluster.ray_cluster import ExecutorOptions, RayCluster
from gcbench.renderer.generate import ray_rendering
from gcbench.renderer.generate.driver import render_dataset
from gcbench.renderer.generate.worker_process import RenderTask

from ...support.ray_nodes import Nodes, start_nodes
from ..generate.test_generate import CONFIG, HERE, SOURCE, N, content, until

RENDER = ["render", "--robot", "owi535", "--frames", "2", "--width", "64", "--height", "48"]
MANY = 40
COMMAND = f"""
import sys
from pathlib import Path
from gcbench import GcbenchError, RayWorkers
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.generate import driver, ray_rendering
config = RenderConfig(robot=sys.argv[2], frames=4, width=32, height=24)
ray_rendering.LIFETIME = 4
try:
    driver.render_dataset(config, {N}, Path(sys.argv[1]), RayWorkers("local", 2), True, "{SOURCE}")
except GcbenchError as error:
    sys.exit(str(error))
"""
needs_ray = pytest.mark.skipif(
    not importlib.util.find_spec("ray"), reason="no ray: pip install '.[cluster]'")


# -- the options ------------------------------------------------------------------------------


@pytest.mark.parametrize(("address", "count", "gpus", "message"), [
    ("auto", -1, 0.0, "--workers -1: give 1 or more, or 0 for one for each CPU"),
    ("auto", None, 1.5, "--gpus 1.5: give a share of a GPU, or a number of them"),
    ("auto", None, -1.0, "--gpus -1: give a share"),
    ("auto", None, float("nan"), "--gpus nan: give a share"),
    ("auto", None, float("inf"), "--gpus inf: give a share"),
    ("ray://head:10001", None, 0.0, "give auto or HOST:PORT, on a node of the cluster"),
    ("head", None, 0.0, "--address 'head': give auto or HOST:PORT"),
])  # fmt: skip
def test_wrong_workers_are_one_line(
    address: str, count: int | None, gpus: float, message: str
) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        RayWorkers(address, count, gpus)
    assert "\n" not in str(caught.value)


def test_the_address_of_auto_may_be_a_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_ADDRESS", "head:6379")
    assert RayWorkers().endpoint == "head:6379" and RayWorkers("local").endpoint == "local"
    monkeypatch.setenv("RAY_ADDRESS", "ray://head:10001")
    with pytest.raises(ConfigError, match="on a node of the cluster"):
        RayWorkers()


def test_options_of_ray_need_ray() -> None:
    assert ExecutorOptions().choose_workers(3) == 3
    assert ExecutorOptions(executor="ray", gpus=0.5).choose_workers(None) == RayWorkers(gpus=0.5)
    for address, gpus, option in (("auto", 0.0, "--address"), ("", 0.5, "--gpus")):
        with pytest.raises(ConfigError, match=f"{option} is for --executor ray"):
            ExecutorOptions(address=address, gpus=gpus).choose_workers(None)


@pytest.mark.parametrize(("count", "gpus", "tasks", "expected"), [
    (None, 0.0, None, (10, 1)),
    (None, 0.0, 3, (3, 2)),
    (None, 0.0, 0, (1, 8)),
    (2, 0.0, None, (2, 4)),
    (1, 0.0, None, (1, 8)),
    (30, 0.0, None, (30, 1)),  # the cluster may grow
    (None, 0.25, None, (6, 1)),  # 8 shares of a GPU on one node, 0 on the other; 4 of 0.5 GPU
    (2, 0.5, None, (2, 2)),
])
def test_workers_share_the_nodes(
    count: int | None, gpus: float, tasks: int | None, expected: tuple[int, int]
) -> None:
    nodes = ({"CPU": 8.0}, {"CPU": 2.0}, {"memory": 1e9}) if not gpus else (
        {"CPU": 8.0}, {"CPU": 4.0, "GPU": 2.0}, {"CPU": 2.0, "GPU": 0.5})
    assert RayCluster(RayWorkers("auto", count, gpus), nodes).plan(tasks) == expected


def test_what_the_cluster_lacks_is_one_line() -> None:
    with pytest.raises(ConfigError, match="--gpus 1: no node of the Ray cluster has so many"):
        RayCluster(RayWorkers(gpus=1), ({"CPU": 8.0},)).plan(5)
    with pytest.raises(ConfigError, match="has no CPUs yet; give the number of --workers"):
        RayCluster(RayWorkers(), ({"memory": 1e9},)).plan(5)


def test_without_ray_the_error_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    out = tmp_path / "out"
    assert main([*RENDER, "--n", "1", "--out", str(out), "--executor", "ray"]) == 2
    assert capsys.readouterr().err == (
        "gcbench: --executor ray needs ray: pip install '.[cluster]'\n")
    assert not out.exists()


@needs_ray
def test_no_cluster_is_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:9")
    assert main([*RENDER, "--n", "1", "--out", str(out), "--executor", "ray"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("gcbench: no connection to Ray at 127.0.0.1:9 (")
    assert said.count("\n") == 1 and "ray start --head" in said
    assert not out.exists()


def test_a_node_that_does_not_see_the_dataset_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.syspath_prepend(str(HERE))
    monkeypatch.setattr(ray_rendering, "_LATE", 0.0)
    task = RenderTask(SOURCE, CONFIG, tmp_path / "out", 1)
    runner = ray_rendering.RayRenderer(task, False, 1)
    with pytest.raises(RenderError, match=r"does not see .*out; give --out a folder that all"):
        runner.run(0)
    render_dataset(replace(CONFIG, seed=3), 1, tmp_path / "out", 1, False, SOURCE)
    with pytest.raises(ConfigError, match="another configuration"):
        runner.run(0)
    assert len(content(tmp_path / "out")) == 2


# -- Ray on this machine ----------------------------------------------------------------------


def run_fake(out: Path, robot: str = "arm") -> subprocess.CompletedProcess[str]:
    """Render with two actors that are recycled after four sequences each."""
    path = os.pathsep.join(filter(None, [str(HERE), os.environ.get("PYTHONPATH", "")]))
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", COMMAND, str(out), robot], timeout=300,
        capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path})


@needs_ray
def test_two_actors_make_what_one_process_makes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing but the bar is printed, and no actor is left."""
    done = run_fake(tmp_path / "ray")
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert not done.stderr or f"{4 * N}/{4 * N}" in done.stderr  # a fast machine needs no bar
    assert "ray" not in done.stderr.lower()
    monkeypatch.syspath_prepend(str(HERE))
    render_dataset(CONFIG, N, tmp_path / "local", 1, False, SOURCE)
    assert content(tmp_path / "ray") == content(tmp_path / "local")


@needs_ray
@pytest.mark.slow
def test_a_ray_of_this_machine_listens_to_no_other() -> None:
    """Whoever reaches a Ray can run anything in it. /proc lists who listens, by address."""
    code = """
import os
from pathlib import Path
from gcbench.renderer.cluster import RayWorkers, connect_to_ray

def sockets():
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if b"MARK=of this test" in path.read_bytes():
                yield from (os.readlink(fd) for fd in (path.parent / "fd").iterdir())
        except OSError:
            pass

with connect_to_ray(RayWorkers("local", 1)) as cluster:
    files = [Path("/proc/net", name).read_text() for name in ("tcp", "tcp6")]
    lines = [line.split() for text in files for line in text.splitlines()]
    mine = {*sockets()}
    print(*{line[1].split(":")[0][-8:] for line in lines
            if line[3] == "0A" and f"socket:[{line[9]}]" in mine})
assert not {name for name in os.environ if name.startswith("RAY_ENABLE")}
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120,
                          env={**os.environ, "MARK": "of this test"})
    assert (done.returncode, done.stdout) == (0, "0100007F\n"), done.stderr  # 127.0.0.1


@needs_ray
@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.skipif(Path("/dev/nvidiactl").exists(), reason="there is a GPU")
def test_a_worker_on_a_gpu_never_draws_without_it(tmp_path: Path) -> None:
    """Ray believes that a node has a GPU."""
    with start_nodes(1, num_gpus=1) as cluster:
        run = start(cluster, tmp_path / "out", "--gpus", "0.5")
        said, errors = run.communicate(timeout=300)
    assert (run.returncode, said) == (2, "")
    assert re.search(r"gcbench: node \S+: no EGL device is 'cuda:0'; .*\n$", errors)
    assert "Traceback" not in errors
    assert not (tmp_path / "out").exists()


@needs_ray
@pytest.mark.slow
def test_a_sequence_that_kills_its_workers_is_given_up(tmp_path: Path) -> None:
    done = run_fake(tmp_path, "crash=5:")
    assert done.returncode == 1
    assert done.stderr.count("sequence 000005: its worker died; tried again") == 3
    assert done.stderr.endswith("sequence 000005: its worker died 4 times; the same command tries "
                                "again\n")
    assert len(content(tmp_path)) == N  # dataset.json, and all but one


@needs_ray
@pytest.mark.slow
@pytest.mark.parametrize(("robot", "message"), [
    ("error=3", r"sequence 000003: node \S+: the light went out\n"),
    ("nowhere", r"node \S+: no robot 'nowhere'\n"),
    ("bug=3", r"(?s)RuntimeError: sequence 000003: .*ZeroDivisionError: of a bug\n"),
])
def test_an_error_of_an_actor_is_that_of_the_run(
    robot: str, message: str, tmp_path: Path
) -> None:
    done = run_fake(tmp_path / "out", robot)
    assert done.returncode == 1 and re.search(message + r"\s*$", done.stderr), done.stderr
    assert ("Traceback" in done.stderr) == (robot == "bug=3")


# -- a cluster of several nodes ---------------------------------------------------------------


@pytest.fixture(scope="module")
def nodes() -> Generator[Nodes]:
    pytest.importorskip("ray")
    with start_nodes(3) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    out = tmp_path_factory.mktemp("expected") / "out"
    assert main([*RENDER, "--n", str(MANY), "--out", str(out), "--workers", "2", "--quiet"]) == 0
    return content(out)


def start(nodes: Nodes, out: Path, *more: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "gcbench", *RENDER, "--n", str(MANY), "--out", str(out),
         "--executor", "ray", "--address", nodes.address, *more],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(run: subprocess.Popen[str]) -> str:
    said, errors = run.communicate(timeout=300)
    assert run.returncode == 0, errors
    assert said.count("\n") <= 3 and f"{MANY} sequences" in said, said
    return errors


def some(out: Path, count: int) -> bool:
    return until(lambda: len(list(out.glob("sequences/[!.]*.zip"))) >= count, 120)


@needs_ray
@pytest.mark.slow
@pytest.mark.gl
def test_a_killed_node_changes_nothing(
    nodes: Nodes, tmp_path: Path, expected: dict[str, str]
) -> None:
    run = start(nodes, tmp_path)
    assert some(tmp_path, 5)
    nodes.kill()
    assert len(content(tmp_path)) < MANY
    finish(run)
    assert content(tmp_path) == expected
    nodes.add()


@needs_ray
@pytest.mark.slow
@pytest.mark.gl
def test_killed_actors_change_nothing(
    nodes: Nodes, tmp_path: Path, expected: dict[str, str]
) -> None:
    run, rng = start(nodes, tmp_path), random.Random(7)
    for count in (3, 8, 13):
        assert some(tmp_path, count)
        with suppress(ProcessLookupError):
            os.kill(rng.choice(nodes.actors()), signal.SIGKILL)
    errors = finish(run)
    assert "its worker died; tried again" in errors or "a worker before its first task" in errors
    assert content(tmp_path) == expected


@needs_ray
@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_a_driver_that_ends_leaves_whole_sequences_and_no_actor(
    how: signal.Signals, nodes: Nodes, tmp_path: Path, expected: dict[str, str]
) -> None:
    """The same command continues."""
    run = start(nodes, tmp_path)
    assert some(tmp_path, 5)
    assert nodes.actors()
    run.send_signal(how)
    _, errors = run.communicate(timeout=120)
    if how == signal.SIGINT:
        assert run.returncode == 130 and errors.endswith(
            "gcbench: stopped; run the same command again to continue\n")
    assert until(lambda: not nodes.actors(), 60)
    there = content(tmp_path)
    assert 5 < len(there) < MANY
    whole = {name for name in there if not Path(name).name.startswith(".")} - {"dataset.json"}
    assert {name: there[name] for name in whole} == {name: expected[name] for name in whole}
    finish(start(nodes, tmp_path))
    assert content(tmp_path) == expected


@needs_ray
@pytest.mark.slow
@pytest.mark.gl
def test_actors_write_to_object_storage_themselves(
    nodes: Nodes, tmp_path: Path, expected: dict[str, str]
) -> None:
    """The nodes have the variables of the machine that started them: here, of this test."""
    from ...support.s3_server import BUCKET, s3_server

    with s3_server(tmp_path / "cache"), start_nodes(2) as others:
        address = f"s3://{BUCKET}/ray"
        finish(start(others, Path(address)))
        import fsspec

        files = fsspec.filesystem("s3", skip_instance_cache=True)
        found = files.find(f"{BUCKET}/ray")
        local = tmp_path / "copy"
        files.get(f"{BUCKET}/ray", str(local), recursive=True)
    assert len(found) == MANY + 1
    assert {k: v for k, v in content(local).items() if k != "dataset.json"} == {
        k: v for k, v in expected.items() if k != "dataset.json"}
