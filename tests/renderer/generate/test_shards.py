"""Many processes render one dataset: the result is that of one run."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from gcbench import ConfigError, Shard, open_dataset
from gcbench.renderer.generate.driver import Summary, render_dataset
from gcbench.renderer.generate.options import render_options

from .test_generate import CONFIG, HERE, SOURCE, N, content, only_whole_ones, until

COMMAND = f"""
import sys
from pathlib import Path
from gcbench import Shard
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.generate.driver import render_dataset
config = RenderConfig(robot="arm", frames=4, width=32, height=24)
shard = Shard({N}, int(sys.argv[2]), int(sys.argv[3]))
render_dataset(config, shard, Path(sys.argv[1]), 1, False, "{SOURCE}")
"""


@pytest.fixture(autouse=True)
def _source(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(HERE))
    before = os.environ.get("PYTHONPATH", "")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), *filter(None, [before])]))


def run(out: Path, shard: Shard | int, seed: int = 0) -> Summary:
    config = dataclasses.replace(CONFIG, robot="arm", seed=seed)
    return render_dataset(config, shard, out, 1, progress=False, source=SOURCE)


def start(out: Path, index: int, count: int, seconds: float = 0.0) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, str(out), str(index), str(count)],
        start_new_session=True, env={**os.environ, "FAKE_SECONDS": str(seconds)})


@pytest.fixture
def expected(tmp_path: Path) -> dict[str, str]:
    run(tmp_path / "expected", N)
    return content(tmp_path / "expected")


def test_shards_one_after_the_other_make_what_one_run_makes(
    tmp_path: Path, expected: dict[str, str]
) -> None:
    out = tmp_path / "out"
    for k in (2, 0, 1):
        summary = run(out, Shard(N, k, 3))
        assert (summary.rendered, summary.sequences) == (N // 3, N // 3)
        assert (open_dataset(out).info.counts is None) == (k != 1)  # the last one counts
    assert content(out) == expected
    assert run(out, Shard(N, 1, 3)).rendered == 0
    assert content(out) == expected
    run(out, Shard(N + 2, 0, 2))  # the dataset grows
    assert open_dataset(out).info.counts is None
    assert run(out, N + 2).rendered == 1


def test_shards_at_the_same_time_make_what_one_run_makes(
    tmp_path: Path, expected: dict[str, str]
) -> None:
    out = tmp_path / "out"
    running = [start(out, k, 4, 0.02) for k in range(4)]
    assert [process.wait(60) for process in running] == [0] * 4
    assert content(out) == expected


def test_a_killed_shard_continues_beside_another(tmp_path: Path, expected: dict[str, str]) -> None:
    out = tmp_path / "out"
    slow, killed = start(out, 0, 2, 0.05), start(out, 1, 2, 0.2)
    assert until(lambda: list(out.glob("sequences/.*.tmp")))
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    only_whole_ones(out)
    again = start(out, 1, 2)
    assert (slow.wait(60), again.wait(60)) == (0, 0)
    assert content(out) == expected
    assert not list(out.glob("sequences/.*"))


def test_a_shard_leaves_the_files_of_others_alone(tmp_path: Path) -> None:
    (tmp_path / "sequences").mkdir()
    mine, other = (tmp_path / f"sequences/.{i:06d}.zip.999999999.tmp" for i in (0, 1))
    mine.touch()
    other.touch()
    run(tmp_path, Shard(4, 0, 2))
    assert not mine.exists() and other.exists()  # it may run on another machine
    run(tmp_path, 4)
    assert not other.exists()


def test_another_configuration_is_refused_before_the_first_sequence(tmp_path: Path) -> None:
    slow = start(tmp_path, 0, 2, 0.5)
    assert until((tmp_path / "dataset.json").exists)
    with pytest.raises(ConfigError, match="seed: 0 -> 7"):
        run(tmp_path, Shard(N, 1, 2), seed=7)
    with pytest.raises(ConfigError, match="another gcbench is writing"):
        run(tmp_path, N)
    os.killpg(slow.pid, signal.SIGKILL)
    slow.wait()


def test_machines_are_recorded_once_each(tmp_path: Path) -> None:
    run(tmp_path, Shard(N, 0, 2))
    file = tmp_path / "dataset.json"
    tree = json.loads(file.read_text())
    file.write_text(json.dumps(tree | {"dependencies": {"numpy": "1.0"}}))
    run(tmp_path, Shard(N, 1, 2))
    run(tmp_path, Shard(N, 1, 2))
    environments = open_dataset(tmp_path).info.environments
    assert [e["dependencies"] for e in environments] == [{"numpy": "1.0"}, tree["dependencies"]]


def test_of_many_runs_one_creates_the_description(tmp_path: Path) -> None:
    from gcbench.robots.files import create_atomically

    barrier, won = threading.Barrier(8), list[bytes]()

    def create(data: bytes) -> None:
        barrier.wait()
        if create_atomically(tmp_path / "file", data):
            won.append(data)

    threads = [threading.Thread(target=create, args=(b"%d" % k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(won) == 1 and (tmp_path / "file").read_bytes() == won[0]
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_what_fails_at_once_leaves_no_folder(tmp_path: Path) -> None:
    config = dataclasses.replace(CONFIG, robot="nowhere")
    with pytest.raises(ConfigError.__mro__[1]):
        render_dataset(config, Shard(4, 0, 2), tmp_path / "out", 1, False, SOURCE)
    assert not (tmp_path / "out").exists()


def test_the_option_is_a_shard_of_all_sequences() -> None:
    assert render_options(["--n", "100", "--shard", "3/64"], None).n == Shard(100, 3, 64)


def test_a_shard_and_a_choice_exclude_each_other() -> None:
    with pytest.raises(ConfigError, match="--shard and --sequences exclude each other"):
        render_options(["--shard", "0/2", "--sequences", "1"], None)
