"""Worker processes end when they should, and one that dies or hangs costs one task."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from gcbench.renderer.runtime import WorkerPool, WorkerSettings
from gcbench.robots.files import lock_folder
from gcbench.robots.files.atomic import is_alive


@pytest.fixture(autouse=True)
def _targets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "support"))


def run(tasks: list[str], **settings: Any) -> Iterator[tuple[Any, str, Any]]:
    """(task, kind of event, content) until all is done."""
    pool = WorkerPool(WorkerSettings("pool_targets:obey", ("ready",), **settings), tasks)
    with closing(pool.events()) as events:
        for event in events:
            task = event.worker.task
            if event.kind == "message":
                event.worker.release()
            yield task, event.kind, event.content


def gone(pid: int) -> bool:
    end = time.monotonic() + 20.0
    while is_alive(pid):
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def test_every_task_is_done_once_by_processes_of_a_lifetime() -> None:
    tasks = [str(i) for i in range(7)]
    done = [(task, pid) for task, _, pid in run(tasks, workers=2, lifetime=3) if task is not None]
    assert sorted(task for task, _ in done) == tasks
    lives = Counter(pid for _, pid in done)
    assert max(lives.values()) <= 3
    assert all(gone(pid) for pid in lives)


def test_of_what_foreign_code_prints_the_end_is_kept() -> None:
    sizes = [int(size) for task, _, size in run(["shout"], foreign=True) if task is not None]
    assert len(sizes) == 1 and sizes[0] < 3 * 2**20


def test_folders_of_pools_that_were_killed_are_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    killed, running, other = (tmp_path / f".gcbench-pool-{name}" for name in ("1", "2", "3"))
    other.mkdir()  # without a lock
    mine = tmp_path / "gcbench-data"  # a dataset has a lock, too
    for folder in (killed, running, mine):
        folder.mkdir(parents=True)
        (folder / "half").touch()
        (folder / ".lock").touch()
        os.utime(folder, (0, 0))
    with lock_folder(running):
        assert len([*run(["a"], foreign=True)]) == 2
        assert {*tmp_path.iterdir()} == {running, other, mine}


@pytest.mark.parametrize("foreign", [False, True])
def test_a_death_costs_one_task(foreign: bool) -> None:
    events = [e for e in run(["a", "die", "exit", "b"], foreign=foreign) if e[0] is not None]
    assert [(task, kind) for task, kind, _ in events] == [
        ("a", "message"), ("die", "died"), ("exit", "died"), ("b", "message"),
    ]
    assert [content for _, kind, content in events if kind == "died"] == [
        "was killed by SIGSEGV", "exited with 3",
    ]


def test_a_task_may_be_tried_again() -> None:
    pool = WorkerPool(WorkerSettings("pool_targets:obey", ("ready",)), ["die", "a"])
    tries = 0
    with closing(pool.events()) as events:
        for event in events:
            if event.kind == "died":
                tries += 1
                if tries < 3:
                    pool.todo.appendleft("die")
            else:
                event.worker.release()
    assert tries == 3


def test_a_hang_costs_one_task_and_what_it_printed_is_known() -> None:
    settings = WorkerSettings("pool_targets:obey", ("ready",), start_limit=60.0, foreign=True)
    pool = WorkerPool(settings, ["hang", "a"])
    ends, said = list[tuple[str, str]](), ""
    with closing(pool.events()) as events:
        for event in events:
            if event.worker.task is not None:
                ends.append((event.worker.task, event.kind))
            if event.kind == "late":
                said = event.worker.last_output()
            elif event.content == "begun":
                event.worker.allow(1.0)
            else:
                event.worker.release()
    assert ends == [("hang", "message"), ("hang", "late"), ("a", "message")]
    assert said == "; it said:\ntask hang"


def test_what_foreign_code_starts_ends_with_it() -> None:
    for _, _, content in run(["spawn"], foreign=True):
        if content != "ready":
            child = content
            break
    assert gone(child)


def test_closing_the_events_ends_every_process() -> None:
    pids = list[int]()
    for task, _, content in run(["a", "b", "c", "d"], workers=2):
        if task is not None:
            pids.append(content)
        if len(pids) == 2:
            break
    assert all(gone(pid) for pid in pids)
    assert is_alive(os.getpid())


def test_variables_of_the_user_take_precedence(monkeypatch: pytest.MonkeyPatch) -> None:
    def seen() -> list[Any]:
        found = run(["variable"], environment={"POOL_TEST": "pool"})
        return [content for task, _, content in found if task]

    assert seen() == ["pool"]
    assert "POOL_TEST" not in os.environ
    monkeypatch.setenv("POOL_TEST", "user")
    assert seen() == ["user"]


# -- scripts without `if __name__ == "__main__":` ---------------------------------------------

SCRIPT = """
import gcbench as gb

print("the script runs")
config = gb.RenderConfig("owi535", frames=2, width=64, height=48, keep_unobservable=True)
print(gb.render_dataset(config, 5, "data", 1, progress=False).sequences)
print(gb.verify_dataset("data", 2, progress=False).ok)
"""
METHOD = """
from pathlib import Path
import gcbench as gb

class Still:
    name, version, inputs, knowledge, training = "still", "1", ("none",), ("none",), "none"

gb.evaluate(gb.EvalConfig(method=("script.py:Still",), data=(Path("data"),)), progress=False)
"""


def run_script(text: str, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "script.py").write_text(text)
    return subprocess.run([sys.executable, "script.py"], cwd=folder, capture_output=True,
                          text=True, timeout=300)


@pytest.mark.gl
def test_workers_do_not_run_the_script_again(tmp_path: Path) -> None:
    done = run_script(SCRIPT, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n") == ["the script runs", "5", "True", ""]
    assert "Traceback" not in done.stderr


def test_a_method_in_such_a_script_is_told_the_fix(tmp_path: Path) -> None:
    """Its process imports the script."""
    done = run_script(METHOD, tmp_path)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("gcbench.errors.MethodError: ")
    assert 'below `if __name__ == "__main__":`' in last
    assert done.stderr.count("Traceback") == 1
