"""A run may end in any way at any moment; the same command then makes the same dataset."""

from __future__ import annotations

import dataclasses
import fcntl
import hashlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from gcbench import ConfigError, GcbenchError, open_dataset
from gcbench.renderer.dataset.storage import open_sequence
from gcbench.renderer.generate.driver import Summary, plan_workers, render_dataset, render_sequence
from gcbench.renderer.generate.worker_pool import WorkerDied, render_in_workers
from gcbench.renderer.generate.worker_process import ModelLoaded, RenderTask, SequenceDone
from gcbench.renderer.runtime import workers
from gcbench.renderer.runtime.shards import Shard
from gcbench.renderer.scene.config import RenderConfig

CONFIG = RenderConfig(robot="arm", frames=4, width=32, height=24)
N = 12
SOURCE = "fake_source:FakeRenderer"
HERE = Path(__file__).parents[2] / "support"


@pytest.fixture(autouse=True)
def _source(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(HERE))
    before = os.environ.get("PYTHONPATH", "")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), *filter(None, [before])]))


def run(out: Path, n: int = N, workers: int = 1, robot: str = "arm") -> Summary:
    config = dataclasses.replace(CONFIG, robot=robot)
    return render_dataset(config, n, out, workers, progress=False, source=SOURCE)


def content(out: Path) -> dict[str, str]:
    """Digest of every file that a reader sees."""
    return {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    out = tmp_path_factory.mktemp("expected")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(HERE))
        run(out)
    found = content(out)
    assert sorted(found) == ["dataset.json", *(f"sequences/{i:06d}.zip" for i in range(N))]
    return found


COMMAND = f"""
try:
    import sys
    from pathlib import Path
    from gcbench.renderer.scene.config import RenderConfig
    from gcbench.renderer.generate.driver import render_dataset
    config = RenderConfig(robot="arm", frames=4, width=32, height=24)
    render_dataset(config, {N}, Path(sys.argv[1]), 2, source="{SOURCE}")
except KeyboardInterrupt:
    sys.exit(130)
"""


def start(out: Path, seconds: float = 0.05) -> subprocess.Popen[str]:
    """The same run, of so many seconds a frame, in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, str(out)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "FAKE_SECONDS": str(seconds)},
    )


def is_alone(group: int) -> bool:
    """Whether no process of the group runs any more; zombies do not run."""
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, member, *_ = path.read_text(errors="replace").rpartition(")")[2].split()
            if int(member) == group and state not in "ZX":
                return False
    return True


def until(condition: Callable[[], object], seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def some_are_there(out: Path) -> bool:
    return len(list(out.glob("sequences/*.zip"))) >= 2


def only_whole_ones(out: Path) -> None:
    for path in out.glob("sequences/[!.]*"):
        assert len([frame.rgb for frame in open_sequence(path)]) == 4


# -- the result does not depend on how it was reached -----------------------------------------


def test_a_value_that_the_dataset_could_not_hold_is_refused_before_anything_is_written(
    tmp_path: Path,
) -> None:
    config = RenderConfig("owi535", frames=3, width=64, height=48, stream="tets")  # pyright: ignore
    for call in (lambda: render_dataset(config, 1, tmp_path / "out", 1, progress=False),
                 lambda: render_dataset(config, 1, tmp_path / "out", 1, False, SOURCE),
                 lambda: render_sequence(config)):
        with pytest.raises(ConfigError, match=r"RenderConfig.* expected one of .*, got "):
            call()
    assert not (tmp_path / "out").exists()


def test_two_workers_make_what_one_makes(tmp_path: Path, expected: dict[str, str]) -> None:
    summary = run(tmp_path, workers=2)
    assert content(tmp_path) == expected
    assert (summary.rendered, summary.sequences, summary.frames) == (N, N, 4 * N)
    assert summary.refused == {"collision": sum(i % 3 for i in range(N))}


def test_what_is_there_is_not_touched(tmp_path: Path, expected: dict[str, str]) -> None:
    run(tmp_path, n=5)
    assert open_dataset(tmp_path).info.counts["sequences"] == 5  # type: ignore[index]
    (tmp_path / "sequences/000003.zip").unlink()
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "sequences").iterdir()}
    assert run(tmp_path).rendered == N - 4
    assert run(tmp_path, n=2).rendered == 0  # fewer are no other dataset
    assert content(tmp_path) == expected
    assert all(p.stat().st_mtime_ns == t for p, t in before.items())


def test_chosen_sequences_are_those_of_the_whole(
    tmp_path: Path, expected: dict[str, str]
) -> None:
    config = dataclasses.replace(CONFIG, robot="arm")
    for wanted in ((7, 3), range(2, 4), (3,)):
        render_dataset(config, wanted, tmp_path, 1, progress=False, source=SOURCE)
    assert open_dataset(tmp_path).names == ("000002", "000003", "000007")
    found = content(tmp_path)
    assert all(found[k] == expected[k] for k in found if k != "dataset.json")
    run(tmp_path)
    assert content(tmp_path) == expected
    for wrong in ((), (-1, 2), 0):
        with pytest.raises(ConfigError, match=r"no sequences to render|there is no sequence -1"):
            render_dataset(config, wrong, tmp_path / "x", 1, progress=False, source=SOURCE)
    empty = Shard(3, 5, 8)
    summary = render_dataset(config, empty, tmp_path / "x", 1, progress=False, source=SOURCE)
    assert (summary.rendered, summary.sequences) == (0, 0) and not (tmp_path / "x").exists()
    for many in (2**62, (2**62,)):
        with pytest.raises(ConfigError, match="a dataset has at most 10000000 sequences"):
            render_dataset(config, many, tmp_path / "x", 1, progress=False, source=SOURCE)


def test_an_unpacked_sequence_counts_as_there(tmp_path: Path) -> None:
    import zipfile

    run(tmp_path, n=2)
    path = tmp_path / "sequences/000001.zip"
    with zipfile.ZipFile(path) as archive:
        archive.extractall(path.with_suffix(""))
    path.unlink()
    assert run(tmp_path, n=2).rendered == 0
    assert open_dataset(tmp_path)[1].meta.index == 1


def test_workers_are_replaced(tmp_path: Path, expected: dict[str, str]) -> None:
    task = RenderTask(SOURCE, CONFIG, tmp_path, 1)
    messages = list(render_in_workers(task, list(range(N)), workers=2, lifetime=3))
    assert sum(isinstance(m, ModelLoaded) for m in messages) >= N / 3
    assert sum(isinstance(m, SequenceDone) for m in messages) == N
    found = content(tmp_path)
    assert found == {name: data for name, data in expected.items() if name != "dataset.json"}


def test_workers_may_die_at_their_start_now_and_then(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every second one does."""
    (tmp_path / "mortal.py").write_text("""
import os, signal, tempfile
from pathlib import Path
from fake_source import FakeRenderer

def start(config):
    folder = Path(__file__).parent
    tempfile.mkstemp(suffix=".start", dir=folder)
    if len(list(folder.glob("*.start"))) % 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return FakeRenderer(config)
""")
    monkeypatch.syspath_prepend(str(tmp_path))
    task = RenderTask("mortal:start", CONFIG, tmp_path / "out", 1)
    messages = list(render_in_workers(task, [0, 1, 2], workers=1, lifetime=1))
    assert sum(isinstance(m, WorkerDied) for m in messages) == 3
    assert len(content(tmp_path / "out")) == 3


@pytest.mark.parametrize("only_parent", [False, True])
def test_a_killed_run_continues(
    tmp_path: Path, expected: dict[str, str], only_parent: bool
) -> None:
    moments = random.Random(0)
    for killed in range(3):
        process = start(tmp_path)
        assert until(lambda most=2 * killed: len(list(tmp_path.glob("sequences/*.zip"))) > most)
        time.sleep(moments.uniform(0.0, 0.1))
        (os.kill if only_parent else os.killpg)(process.pid, signal.SIGKILL)
        process.communicate()
        assert until(lambda pid=process.pid: is_alone(pid))  # no orphan goes on
        only_whole_ones(tmp_path)
    process = start(tmp_path, 0.0)
    _, errors = process.communicate()
    assert process.returncode == 0, errors
    assert content(tmp_path) == expected


def test_ctrl_c_stops_it_cleanly(tmp_path: Path, expected: dict[str, str]) -> None:
    process = start(tmp_path)
    assert until(lambda: some_are_there(tmp_path))
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all of them
    _, errors = process.communicate()
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert until(lambda: is_alone(process.pid))
    only_whole_ones(tmp_path)
    assert not list(tmp_path.rglob("*.tmp"))
    run(tmp_path)
    assert content(tmp_path) == expected


@pytest.mark.ci
def test_ctrl_c_while_workers_start_is_quiet(tmp_path: Path) -> None:
    for i, delay in enumerate((0.0, 0.02, 0.1, 0.2)):
        process = start(tmp_path / str(i))
        assert until((tmp_path / str(i) / ".lock").exists)
        time.sleep(delay)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate()
        assert process.returncode in (0, 130), errors
        assert "Traceback" not in errors


# -- accidents --------------------------------------------------------------------------------


def test_a_worker_that_dies_once_is_replaced(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], expected: dict[str, str]
) -> None:
    run(tmp_path / "out", robot=f"crash=2:{tmp_path / 'marker'}")
    said = [line for line in capfd.readouterr().err.splitlines() if line.strip()]
    assert said == ["gcbench: sequence 000002: its worker was killed by SIGSEGV; tried once more"]
    found = content(tmp_path / "out")
    assert found.keys() == expected.keys()
    assert all(found[k] == v for k, v in expected.items() if k != "dataset.json")


def test_a_sequence_that_kills_twice_fails_after_the_others(tmp_path: Path) -> None:
    with pytest.raises(GcbenchError, match=r"000002.*SIGSEGV"):
        run(tmp_path, n=5, workers=2, robot="crash=2:")
    assert open_dataset(tmp_path).names == ("000000", "000001", "000003", "000004")
    assert open_dataset(tmp_path).info.counts is None  # not finished


def test_an_error_of_a_sequence_names_it(tmp_path: Path) -> None:
    with pytest.raises(GcbenchError, match=r"^sequence 000001: the light went out$"):
        run(tmp_path, robot="error=1")
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_bug_shows_where(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"fake_source\.py.*\n(.*\n)*.*of a bug"):
        run(tmp_path, robot="bug=0")


def test_what_failed_at_once_binds_nobody(tmp_path: Path) -> None:
    with pytest.raises(GcbenchError, match=r"^no robot 'nowhere'$"):
        run(tmp_path, robot="nowhere")
    assert run(tmp_path, n=1).sequences == 1


def test_what_failed_at_once_leaves_no_folder(tmp_path: Path) -> None:
    for robot in ("nowhere", "error=0", "bug=0"):
        with pytest.raises((GcbenchError, RuntimeError)):
            run(tmp_path / "data/out", robot=robot)
        assert list(tmp_path.iterdir()) == []
    (tmp_path / "data").mkdir()
    (tmp_path / "data/notes").touch()
    with pytest.raises(GcbenchError):
        run(tmp_path / "data", robot="error=0")
    assert (tmp_path / "data/notes").exists()


def test_a_full_disk_is_one_line_that_names_the_file(tmp_path: Path) -> None:
    """A limit on the size of files stands for the disk: the same write fails."""
    code = f"""
import resource, sys
sys.path.insert(0, {str(HERE)!r})
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
{COMMAND}
except Exception as error:
    sys.exit(f"{{type(error).__name__}} {{error}}")
"""
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "out")],
                          stderr=subprocess.PIPE, text=True)
    said = done.stderr.splitlines()[-1]
    assert re.fullmatch(rf"RenderError sequence 00000\d: {tmp_path}/out: File too large", said)
    assert list(tmp_path.iterdir()) == []


# -- refusals ---------------------------------------------------------------------------------


def test_another_config_is_refused_with_the_difference(tmp_path: Path) -> None:
    run(tmp_path, n=1)
    before = content(tmp_path)
    other = dataclasses.replace(CONFIG, seed=7, frames=5)
    with pytest.raises(GcbenchError, match=r"seed: 0 -> 7; frames: 4 -> 5\); choose another --out"):
        render_dataset(other, 2, tmp_path, 1, progress=False, source=SOURCE)
    assert content(tmp_path) == before


def test_another_version_or_model_file_is_refused(tmp_path: Path) -> None:
    run(tmp_path, n=1)
    file = tmp_path / "dataset.json"
    tree = json.loads(file.read_text())
    file.write_text(json.dumps(tree | {"generator": {"name": "gcbench", "version": "0.0.1"}}))
    with pytest.raises(GcbenchError, match=r'generator\.version: "0\.0\.1" -> '):
        run(tmp_path, n=2)
    file.write_text(json.dumps(tree | {"assets": [tree["assets"][0] | {"sha256": "11"}]}))
    with pytest.raises(GcbenchError, match=r"other model files \(sha256 changed"):
        run(tmp_path, n=2)
    file.write_text(json.dumps(tree | {"assets": [tree["assets"][0] | {"files": {"a.stl": "1"}}]}))
    with pytest.raises(GcbenchError, match=r"other model files \(a\.stl changed"):
        run(tmp_path, n=2)
    assert open_dataset(tmp_path).names == ("000000",)
    file.write_text(json.dumps(tree | {"assets": [tree["assets"][0] | {"notes": ["old words"]}]}))
    assert "note: old words" in run(tmp_path, n=2).describe()


def test_another_environment_is_recorded(tmp_path: Path) -> None:
    run(tmp_path, n=1)
    file = tmp_path / "dataset.json"
    tree = json.loads(file.read_text())
    file.write_text(json.dumps(tree | {"dependencies": {"numpy": "1.0"}}))
    run(tmp_path, n=2)
    old, new = open_dataset(tmp_path).info.environments
    assert old["dependencies"] == {"numpy": "1.0"}
    assert new["dependencies"] == tree["dependencies"]


def test_a_folder_in_use_is_refused(tmp_path: Path) -> None:
    with (tmp_path / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write("4711")
        file.flush()
        with pytest.raises(GcbenchError, match=r"another gcbench .*4711"):
            run(tmp_path)
    assert run(tmp_path, n=1).sequences == 1


def test_folders_that_will_not_do(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(GcbenchError, match="file"):
        run(tmp_path / "file")
    run(tmp_path / "out", n=1)
    (tmp_path / "out/dataset.json").unlink()
    with pytest.raises(GcbenchError, match=r"no dataset\.json"):
        run(tmp_path / "out")
    for n, count in ((0, 1), (1, -1)):
        with pytest.raises(GcbenchError, match="1 or more"):
            run(tmp_path / "new", n=n, workers=count)
    assert not (tmp_path / "new").exists()


def test_0_workers_are_one_for_each_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "cpu_count", lambda: 6)
    assert [workers.count_workers(n) for n in (None, 0, 1, 9)] == [6, 6, 1, 9]
    with pytest.raises(ConfigError, match="--workers -1: give 1 or more, or 0 for one for each"):
        workers.count_workers(-1)


def test_the_plan_uses_every_core_and_no_more() -> None:
    for cores in (1, 2, 3, 8, 64):
        for requested in (None, 0, 1, 2, 5):
            count, threads = plan_workers(cores, requested)
            assert count == (requested or cores)
            assert threads >= 1
            assert count * threads <= max(cores, count) < count * (threads + 1)


# -- the real thing ---------------------------------------------------------------------------

URDF = """<robot name="pointer">
  <link name="base"><visual><geometry><box size="0.3 0.3 0.1"/></geometry></visual></link>
  <link name="hand"><visual><origin xyz="0.3 0 0.1"/>
    <geometry><box size="0.6 0.1 0.05"/></geometry></visual></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="hand"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
</robot>"""


@pytest.mark.gl
def test_the_command_line_renders(tmp_path: Path) -> None:
    (tmp_path / "pointer.urdf").write_text(URDF)
    out = tmp_path / "out"
    command = (
        f"render --robot {tmp_path / 'pointer.urdf'} --n 3 --frames 4 --width 160 --height 120"
    )
    done = subprocess.run(
        [sys.executable, "-m", "gcbench", *command.split(), "--out", str(out)],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    dataset = open_dataset(out)
    assert len(dataset) == 3
    assert all(len(list(sequence)) == 4 for sequence in dataset)


def test_a_dataset_from_before_an_option_goes_on(tmp_path: Path) -> None:
    run(tmp_path, 1)
    file = tmp_path / "dataset.json"
    tree = json.loads(file.read_text())
    del tree["config"]["layers"], tree["config"]["animation"]
    file.write_text(json.dumps(tree))
    assert run(tmp_path, 2).sequences == 2
    layered = dataclasses.replace(CONFIG, layers=("normal",))
    with pytest.raises(GcbenchError, match="layers"):
        render_dataset(layered, 3, tmp_path, 1, progress=False, source=SOURCE)
