"""What a hostile method can do to an evaluation: nothing but fail."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest
from gcbench import DatasetError, MethodError
from gcbench.__main__ import main
from gcbench.benchmark.results.rows import Attribution
from gcbench.benchmark.results.runs import RUN, Results, read_run
from gcbench.benchmark.run.driver import EvalConfig, evaluate
from gcbench.robots.files.atomic import is_alive

from ...support import bench_data

METHODS = Path(__file__).parents[2] / "support/bad_methods.py"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bench_data.make_dataset(tmp_path_factory.mktemp("data") / "secret-arm", 3)


@pytest.fixture(autouse=True)
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CALLS", str(tmp_path / "calls"))
    return tmp_path / "calls"


def run(data: Path, results: Path, *names: str, timeout: float = 300, memory: float = 0) -> Results:
    config = EvalConfig(
        method=tuple(f"{METHODS}:{name}" for name in names), data=(data,), results=results,
        workers=1, timeout=timeout, memory=memory)
    return evaluate(config, progress=False)


@pytest.mark.parametrize(("name", "failure"), [
    ("ReturnsExit", "invalid: reading what it returned raised SystemExit: 0"),
    ("ReturnsInterrupt", "invalid: reading what it returned raised KeyboardInterrupt: "),
    ("RaisesUnprintable", "raised: UnprintableError (its message cannot be printed)"),
])
def test_what_is_returned_may_raise_anything(
    data: Path, tmp_path: Path, name: str, failure: str
) -> None:
    outcome = run(data, tmp_path / "results", name)
    (line,) = outcome.failures
    assert line.endswith(f"/000001: {failure}")
    assert len(outcome.runs[0].results()) > 0


@pytest.mark.parametrize(("name", "reason"), [
    ("ExitsAtStart", "SystemExit: 0"),
    ("SurrogateName", "name is 'mine\\ud800', expected one line of"),
    ("Scripted", "link 'javascript:alert(1)', date '', expected one line, an address with https"),
])
def test_a_method_that_cannot_start_leaves_the_others_alone(
    data: Path, tmp_path: Path, name: str, reason: str
) -> None:
    outcome = run(data, tmp_path / "results", name, "Good")
    assert [folder.run.row.method for folder in outcome.runs] == ["good"]
    assert outcome.estimated == 3
    assert len(outcome.failures) == 1
    assert reason in outcome.failures[0]
    with pytest.raises(MethodError, match=r"expected one line|SystemExit"):
        run(data, tmp_path / "results", name)


@pytest.mark.parametrize(("times", "estimated", "code"), [("2", 3, 0), ("9", 2, 1)])
def test_a_method_that_has_run_is_loaded_again(
    data: Path, tmp_path: Path, times: str, estimated: int, code: int,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("TIMES", times)
    results = tmp_path / "results"
    assert main(["eval", "--method", f"{METHODS}:DiesTwice", f"{METHODS}:Good", "--data", str(data),
                 "--results", str(results), "--workers", "1"]) == code
    assert len([*results.glob("dies-twice*/**/estimates/*.zip")]) == estimated
    said = f"{METHODS}:DiesTwice: the method's process exited with 9 while it loaded"
    assert (said in capsys.readouterr().out) == bool(code)


def test_a_method_may_say_who_made_it(data: Path, tmp_path: Path) -> None:
    first, second = (run(data, tmp_path / "results", name).runs[0]
                     for name in ("Attributed", "Good"))
    by = read_run(first.path / RUN).attribution
    assert by == Attribution("A. Author", "https://example.org/@a", "2024-05-01")
    assert read_run(second.path / RUN).attribution == Attribution()


def test_a_broken_process_costs_one_sequence(data: Path, tmp_path: Path) -> None:
    (line,) = run(data, tmp_path / "results", "Sabotages").failures
    assert "/000002: crashed: " in line
    assert line.endswith("TypeError: 'NoneType' object is not callable")


@pytest.mark.parametrize(("name", "failure"), [
    ("ForksAndExits", "crashed: the method's process exited with 0"),
    ("LeavesSession", "timeout: no estimate within 6 s"),
])
@pytest.mark.ci
def test_no_process_of_a_method_stays(
    data: Path, tmp_path: Path, calls: Path, name: str, failure: str
) -> None:
    before = time.monotonic()
    outcome = run(data, tmp_path / "results", name, timeout=6.0 if "6 s" in failure else 300.0)
    assert failure in outcome.failures[0]
    assert time.monotonic() - before < 120
    assert not is_alive(int(calls.with_name("calls.pid").read_text()))


def test_memory_is_limited(data: Path, tmp_path: Path) -> None:
    outcome = run(data, tmp_path / "results", "Allocates", memory=1.5)
    assert "Unable to allocate 2.00 GiB" in outcome.failures[0]
    assert run(data, tmp_path / "free", "Allocates").failures == ()


def test_the_process_of_a_method_has_no_truth_and_no_path(
    data: Path, tmp_path: Path, calls: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls.with_name("calls.secret").write_text("secret-arm")
    monkeypatch.setenv("PWD", str(data))
    monkeypatch.setattr("sys.argv", ["gcbench", "eval", "--data", str(data)])
    assert run(data, tmp_path / "results", "Searches").failures == ()


def test_what_a_method_keeps_stays(data: Path, tmp_path: Path) -> None:
    assert run(data, tmp_path / "results", "Keeps").failures == ()


def test_a_truth_that_changed_is_not_scored(data: Path, tmp_path: Path, calls: Path) -> None:
    mine = tmp_path / "mine"
    shutil.copytree(data, mine)
    calls.with_name("calls.data").write_text(str(mine))
    with pytest.raises(DatasetError, match="sequence 000001 changed after it was estimated"):
        run(mine, tmp_path / "results", "Tampers")
    with pytest.raises(DatasetError, match=r"something else \(truth.000001: "):
        run(mine, tmp_path / "results", "Tampers")


def test_a_folder_that_cannot_be_written_is_named(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "results"
    assert main(["eval", "--method", "hold-still", "--data", str(data), "--results", str(out)]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith(f"gcbench: cannot write to {out}") and "Not a directory" in last
