"""A method may do what it wants: it costs itself that sequence, never the run."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from gcbench import ConfigError, DatasetError, GcbenchError, MethodError, ModelError
from gcbench.benchmark.methods import registry as methods
from gcbench.benchmark.methods.baselines import mean_motion
from gcbench.benchmark.protocol.observations import DEPTH_NOISE, observe
from gcbench.benchmark.protocol.scoring import shape_of
from gcbench.benchmark.report.formats import leaderboard_text
from gcbench.benchmark.report.leaderboard import build_leaderboard
from gcbench.benchmark.results.estimates import read_stored
from gcbench.benchmark.results.rows import Result
from gcbench.benchmark.results.runs import Results
from gcbench.benchmark.run import driver
from gcbench.benchmark.run.datasets import Selection, from_folders
from gcbench.benchmark.run.driver import EvalConfig, evaluate
from gcbench.benchmark.run.jobs import Job, shorten_reason
from gcbench.renderer.dataset.reader import open_dataset

from ...support import analytic, bench_data

METHODS = Path(__file__).parents[2] / "support/bad_methods.py"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bench_data.make_dataset(tmp_path_factory.mktemp("data") / "arm", 3)


@pytest.fixture(autouse=True)
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CALLS", str(tmp_path / "calls"))
    return tmp_path / "calls"


def run(data: Path, results: Path, name: str, **changes: object) -> Results:
    method = name if name in methods.METHODS else f"{METHODS}:{name}"
    config = EvalConfig(method=(method,), data=(data,), results=results, workers=1)
    return evaluate(dataclasses.replace(config, **changes), progress=False)  # type: ignore[arg-type]


def of(results: list[Result], metric: str) -> list[float]:
    return [r.value for r in results if r.metric == metric]


@pytest.mark.parametrize(("change", "said"), [
    ({"timeout": float("inf")}, "--timeout inf: expected a finite number of seconds above 0"),
    ({"timeout": float("nan")}, "--timeout nan"),
    ({"timeout": 0.0}, "--timeout 0"),
    ({"memory": float("inf")}, "--memory inf: expected a finite number of GiB .* 0 for no limit"),
    ({"memory": float("nan")}, "--memory nan"),
    ({"memory": 1e12}, "--memory 1e.12"),
    ({"memory": -1.0}, "--memory -1"),
    ({"workers": -1}, "--workers and --limit must be 0 or more"),
])
def test_limits_are_numbers(
    data: Path, tmp_path: Path, change: dict[str, float], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        run(data, tmp_path / "results", "hold-still", **change)
    assert not (tmp_path / "results").exists()


def test_0_workers_are_one_for_each_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "cpu_count", lambda: 6)
    found = [driver._limits(EvalConfig(method=("icp",), workers=n)) for n in (None, 0, 2)]
    assert [(limits.workers, limits.threads) for limits in found] == [(4, 1), (6, 1), (2, 3)]


@pytest.mark.parametrize("folder", ["my project", "me@host", "m(1)+2 & 3=4, 5%", "né", "a:b"])
@pytest.mark.ci
def test_a_method_may_be_in_any_folder(data: Path, tmp_path: Path, folder: str) -> None:
    file = tmp_path / folder / "m.py"
    file.parent.mkdir()
    file.write_text("from gcbench.benchmark.methods.baselines import HoldStill\n"
                    "class Mine(HoldStill):\n    name = 'mine'\n")
    source = f"{file}:Mine"
    assert methods.split_oracles(source) == (source, ())
    assert methods.split_oracles(source + "@true-parts") == (source, ("true-parts",))
    config = EvalConfig(method=(source,), data=(data,), results=tmp_path / "results", workers=1)
    (found,) = evaluate(config, progress=False).runs
    assert (found.run.source, found.run.row.method) == (source, "mine")


def test_a_path_that_no_record_can_hold_is_refused() -> None:
    for name in ("/what?/m.py:M", "/a\nb/m.py:M", os.fsdecode(b"/jos\xe9/m.py:M")):
        with pytest.raises(MethodError, match=r"must be printable text without \?; rename"):
            methods.method_source(name)
    for name in ("my project:M", "m.py", "/x@y/m.txt:M"):
        with pytest.raises(MethodError, match="no method '"):
            methods.method_source(methods.split_oracles(name)[0])


@pytest.mark.skipif(sys.platform != "linux", reason="names are Unicode elsewhere")
@pytest.mark.parametrize("name", [b"arm\xe9", b"jos\xe9/arm"])
def test_a_name_that_no_json_can_express_is_refused(tmp_path: Path, name: bytes) -> None:
    odd = bench_data.make_dataset(tmp_path / os.fsdecode(name), 1)
    with pytest.raises(DatasetError, match=r"udce9.*: its name is not UTF-8; rename it"):
        run(odd, tmp_path / "results", "hold-still")
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(("name", "status", "reason"), [
    ("Raises", "raised", "ZeroDivisionError: of the method"),
    ("Exits", "raised", "SystemExit: 3"),
    ("Crashes", "crashed", "exited with 7; it said:\nout of luck"),
    ("WrongShape", "invalid", "float64 [4, 1], expected real numbers [T J] = [4 2]"),
    ("Nonsense", "invalid", "returned str, expected gcbench.Estimate"),
])  # fmt: skip
def test_an_accident_costs_one_sequence(
    data: Path, tmp_path: Path, name: str, status: str, reason: str
) -> None:
    outcome = run(data, tmp_path / "results", name)
    (folder,) = outcome.runs
    dataset = open_dataset(data)
    stored = [read_stored(folder.estimate_path(s), shape_of(dataset[s])) for s in dataset.names]
    assert [s.status for s in stored] == ["ok", status, "ok"]
    assert reason in stored[1].reason
    assert len(outcome.failures) == 1
    assert f"arm/000001: {status}" in outcome.failures[0]
    results = folder.results()
    assert of(results, "covered") == [1, 1, 0, 0, 1, 1]
    # Each counts as no motion: the error of all is the displacement.
    assert of(results, "final_error") == pytest.approx(of(results, "displacement"))
    (line,) = build_leaderboard(outcome.runs).lines
    assert line.summary.coverage == pytest.approx(100 * 4 / 6)
    assert line.summary.joints == 6
    assert "66.7 %" in leaderboard_text(build_leaderboard(outcome.runs))


def test_a_method_that_hangs_is_ended(data: Path, tmp_path: Path) -> None:
    outcome = run(data, tmp_path / "results", "Hangs", timeout=1.0)
    assert of(outcome.runs[0].results(), "covered") == [1, 1, 0, 0, 1, 1]
    assert "timeout: no estimate within 1 s; it said:" in outcome.failures[0]


def test_nan_costs_the_joint(data: Path, tmp_path: Path) -> None:
    outcome = run(data, tmp_path / "results", "Nan")
    assert of(outcome.runs[0].results(), "covered") == [1, 1, 1, 0, 1, 1]
    assert outcome.failures == ()


@pytest.mark.parametrize(("name", "message"), [
    ("NoMethod", "no function estimate(observation). A method is a class"),
    ("CannotStart", "weights.safetensors"),
    ("Nowhere", "has no 'Nowhere'; it has"),
])  # fmt: skip
def test_what_is_no_method_is_told(data: Path, tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(GcbenchError) as error:
        run(data, tmp_path / "results", name)
    assert message in str(error.value)
    assert not (tmp_path / "results").exists()


def test_unknown_names_list_what_exists() -> None:
    with pytest.raises(GcbenchError, match=r"no method 'gcpos' .*; there are .*gcpose, .*icp"):
        methods.method_source("gcpos")
    with pytest.raises(GcbenchError, match="no oracle 'true-depth'; there are true-parts"):
        methods.split_oracles("icp@true-depth")
    assert methods.split_oracles("icp@true-parts+true-flow") == ("icp", ("true-parts", "true-flow"))
    with pytest.raises(GcbenchError, match=r"nofile\.py: no such file"):
        methods.load_method("nofile.py:Method")
    with pytest.raises(GcbenchError, match="no module 'no_such_module'"):
        methods.load_method("no_such_module.deep:Method")
    with pytest.raises(GcbenchError, match="json:loads: missing a required argument: 's'; meth"):
        methods.load_method("json:loads")
    assert methods.METHODS["gcpose"] == "gcbench.gcpose.method:GCPose"


def test_installed_packages_add_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [EntryPoint("theirs", "package.module:Method", methods.GROUP),
             EntryPoint("gcpose", "package.module:Impostor", methods.GROUP)]
    with monkeypatch.context() as patch:
        patch.setattr(methods.metadata, "entry_points", lambda group: found)
        methods.registered_methods.cache_clear()
        assert methods.method_source("theirs") == "package.module:Method"
        assert methods.method_source("gcpose") == methods.METHODS["gcpose"]
    methods.registered_methods.cache_clear()


def test_rows_are_what_is_supported(data: Path) -> None:
    declared = methods.Declaration("m", "1", "none", ("rgb", "rgbd"), ("free", "axes"))
    rows = methods.plan_rows(declared)
    assert [(r.inputs, r.knowledge) for r in rows] == [
        ("rgb", "free"), ("rgb", "axes"), ("rgbd", "free"), ("rgbd", "axes")]
    with pytest.raises(GcbenchError, match=r"support inputs rgbd-noise; it supports rgb, rgbd$"):
        methods.plan_rows(declared, (), ("rgbd-noise",))
    hinting = dataclasses.replace(declared, hint="more with --depth")
    with pytest.raises(GcbenchError, match=r"rgb, rgbd; more with --depth$"):
        methods.plan_rows(hinting, (), ("rgbd-noise",))
    with pytest.raises(GcbenchError, match=r"supports free, axes$"):
        methods.plan_rows(hinting, (), (), ("kinematics",))
    assert len(methods.plan_rows(declared, ("true-parts",), ("rgb",), ("free",))) == 1


def test_what_is_there_is_not_run_again(data: Path, tmp_path: Path, calls: Path) -> None:
    results = tmp_path / "results"
    outcome = run(data, results, "Crashes")
    assert calls.read_text() == "xxx"
    (folder,) = outcome.runs
    before = (folder.path / "scores.csv").read_bytes()
    assert run(data, results, "Crashes").estimated == 0
    assert calls.read_text() == "xxx"
    assert (folder.path / "scores.csv").read_bytes() == before
    folder.estimate_path("000002").unlink()
    folder.estimate_path("000000").write_bytes(b"PK damaged")
    assert run(data, results, "Crashes").estimated == 2
    assert calls.read_text() == "xxxxx"
    again = run(data, results, "Crashes", retry=("crashed",))
    assert again.estimated == 1
    assert again.failures == ()


def test_another_version_does_not_mix(data: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    (folder,) = run(data, results, "Good").runs
    path = folder.path / "run.json"
    tree = json.loads(path.read_text())
    tree["row"]["version"] = "0"
    path.write_text(json.dumps(tree))
    with pytest.raises(GcbenchError, match=r'something else .*version: "0" -> "1"'):
        run(data, results, "Good")
    assert run(data, results, "Good", retry=("ok",)).estimated == 3


@pytest.mark.parametrize("folder", ["", "../", "/elsewhere/", "C:\\me\\"])
def test_the_same_file_by_another_path_continues(
    data: Path, tmp_path: Path, folder: str
) -> None:
    results = tmp_path / "results"
    (found,) = run(data, results, "Good").runs
    path = found.path / "run.json"
    tree = json.loads(path.read_text())
    name = tree["source"].rpartition("/")[2]
    path.write_text(json.dumps({**tree, "source": folder + name}))
    assert run(data, results, "Good").estimated == 0
    path.write_text(json.dumps({**tree, "source": folder + "other_" + name}))
    with pytest.raises(GcbenchError, match=r"something else \(source: .*choose another --results"):
        run(data, results, "Good")


def test_estimates_of_nobody_knows_what_are_refused(data: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    (folder,) = run(data, results, "Good").runs
    (folder.path / "run.json").unlink()
    with pytest.raises(GcbenchError, match=r"has estimates, but no run\.json .*by --retry ok"):
        run(data, results, "Good")
    assert run(data, results, "Good", retry=("ok",)).estimated == 3


def test_sequences_that_are_no_longer_scored_are_told(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(data, tmp_path, "Good")
    assert "are not among those" not in capsys.readouterr().err
    (folder,) = run(data, tmp_path, "Good", limit=2).runs
    assert folder.run.sequences == ("000000", "000001")
    assert "1 sequences of an earlier command are not among" in capsys.readouterr().err
    assert run(data, tmp_path, "Good").estimated == 0


def test_what_a_method_printed_last_is_told() -> None:
    assert shorten_reason("") == ""
    assert shorten_reason("no estimate within 4 s; it said:\na map\nno map.bin") == (
        "no estimate within 4 s; it said: no map.bin")
    fault = ("Fatal Python error: Segmentation fault\n\nThread 0x1 (most recent call first):\n"
             '  File "m.py", line 7 in estimate\n  File "run.py", line 9 in serve\n\n'
             "Extension modules: numpy (total: 1)")
    assert shorten_reason(f"the process was killed by SIGSEGV; it said:\n{fault}") == (
        'the process was killed by SIGSEGV; it said: File "m.py", line 7 in estimate')
    assert shorten_reason("ValueError: no\n  at line 3") == "ValueError: no"


def test_results_do_not_depend_on_workers(data: Path, tmp_path: Path) -> None:
    def numbers(outcome: Results) -> list[tuple[object, ...]]:
        return [(r.sequence, r.joint, r.frame, r.metric, r.value)
                for r in outcome.runs[0].results() if r.unit not in ("s", "MiB")]

    one = numbers(run(data, tmp_path / "one", "Reads"))
    assert len({value for *_, value in one}) > 3
    assert one == numbers(run(data, tmp_path / "two", "Reads", workers=3))


def test_scores_do_not_depend_on_the_order_of_sequences(data: Path, tmp_path: Path) -> None:
    (folder,) = run(data, tmp_path / "results", "Reads").runs
    (d,) = from_folders([data])
    before = folder.results()
    names = folder.run.sequences[::-1]
    turned = dataclasses.replace(folder, run=dataclasses.replace(folder.run, sequences=names))
    Job(turned, d, ()).score()
    after = folder.results()
    assert after != before
    assert sorted(after, key=repr) == sorted(before, key=repr)


def test_only_what_can_be_seen_is_scored(tmp_path: Path) -> None:
    folder = bench_data.make_dataset(tmp_path / "arm", 3, unobservable=(1,))
    (d,) = from_folders([folder])
    assert d.sequences == ("000000", "000002")
    assert d.left_out == 1
    assert len(from_folders([folder], Selection(keep_unobservable=True))[0].sequences) == 3
    with pytest.raises(GcbenchError, match="two datasets are called 'arm-seed-0'"):
        from_folders([folder, folder])


def test_a_killed_run_continues(data: Path, tmp_path: Path, calls: Path) -> None:
    results = tmp_path / "results"
    command = [sys.executable, "-m", "gcbench", "eval", "--method", f"{METHODS}:Hangs",
               "--data", str(data), "--results", str(results), "--workers", "1"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True)
    try:
        deadline = time.monotonic() + 60
        while not (calls.exists() and calls.read_text() == "xx"):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=30)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130
    assert b"Traceback" not in said
    assert b"run the same command again to continue" in said
    assert run(data, results, "Hangs").estimated == 2


def test_knowledge_is_exactly_what_is_handed_over(data: Path) -> None:
    sequence = open_dataset(data)[1]
    given = {
        (i, k): {f.name for f in dataclasses.fields(o) if getattr(o, f.name) is not None}
        for i, k in [("none", "none"), ("rgb", "free"), ("rgbd", "free"), ("rgbd", "axes"),
                     ("rgbd-noise", "kinematics")]
        for o in [observe(sequence, i, k)]  # type: ignore[arg-type]
    }
    always = {"intrinsics", "times", "n_joints", "joint_types", "joint_parent", "depth_noise"}
    assert observe(sequence, "rgb", "free").joint_parent == (-1, 0)
    axes = {"cam_from_world", "axis_direction"}
    assert given["none", "none"] == always
    assert given["rgb", "free"] == always | {"rgb"}
    assert given["rgbd", "free"] == always | {"rgb", "depth"}
    assert given["rgbd", "axes"] == always | {"rgb", "depth"} | axes
    assert given["rgbd-noise", "kinematics"] == always | {"rgb", "depth"} | axes | {"axis_line"}
    everything = observe(sequence, "rgb", "model", model=analytic.arm())
    assert everything.model is not None
    assert everything.axis_line is not None
    oracle = observe(sequence, "rgb", "free", ("true-parts", "true-flow"))
    assert oracle.part is not None
    assert set(np.unique(oracle.part)) == {0, 1, 2}
    assert oracle.flow is not None
    assert oracle.flow.shape == (3, 36, 48, 2)
    assert oracle.flow_backward is not None
    assert np.array_equal(oracle.flow_backward, sequence.flow_backward[:3], equal_nan=True)
    assert oracle.mask is None
    masked = observe(sequence, "rgb", "free", ("true-mask",))
    assert masked.mask is not None and masked.part is None
    assert np.array_equal(masked.mask, oracle.part > 0)
    for i, k in (("none", "free"), ("rgb", "none")):
        with pytest.raises(GcbenchError, match="do not go together"):
            observe(sequence, i, k)  # type: ignore[arg-type]
    with pytest.raises(GcbenchError, match="needs the articulated model"):
        observe(sequence, "rgb", "model")


def test_noise_is_on_surfaces_and_repeats(data: Path) -> None:
    sequence, other = open_dataset(data)[1], open_dataset(data)[2]
    clean = np.asarray(observe(sequence, "rgbd", "free").depth)
    noisy = np.asarray(observe(sequence, "rgbd-noise", "free").depth)
    assert (noisy == np.asarray(observe(sequence, "rgbd-noise", "axes").depth)).all()
    surface = clean > 0
    assert ((noisy > 0) == surface).all()
    difference = (noisy - clean)[surface]
    assert difference.std() == pytest.approx(DEPTH_NOISE, rel=0.1)
    assert abs(difference.mean()) < 0.005
    again = np.asarray(observe(other, "rgbd-noise", "free").depth)
    assert (np.asarray(observe(other, "rgbd", "free").depth) == clean).all()
    assert not (again == noisy).all()


def test_blind_guesses(data: Path, tmp_path: Path) -> None:
    """Constant velocity is learned from the train stream."""
    still, moving = (run(data, tmp_path, n).runs[0].results()
                     for n in ("hold-still", "constant-velocity"))
    assert of(still, "final_error") == pytest.approx(of(still, "displacement"))
    learned = mean_motion(15, False)
    assert np.degrees(learned[-1]) == pytest.approx(40, abs=2)  # of the recipe's 10 .. 70 deg
    np.testing.assert_allclose(np.diff(learned), learned[-1] / 14, rtol=0.15)  # at one speed
    guess = np.degrees(mean_motion(4, False)[-1])
    error = np.abs(guess - np.array(of(moving, "displacement")))
    np.testing.assert_allclose(of(moving, "final_error"), error)
    assert {r.sign for r in moving if r.joint} == {"best"}
    assert mean_motion(15, True)[-1] == pytest.approx(0.2, abs=0.02)  # a drawer's 4 .. 36 cm


# -- models of datasets from elsewhere --------------------------------------------------------


def shows(data: Path, robot: str) -> Path:
    """The dataset, whose config names another robot."""
    file = data / "dataset.json"
    tree = json.loads(file.read_text())
    tree["config"]["robot"] = robot
    file.write_text(json.dumps(tree))
    return data


def test_a_path_in_a_dataset_is_read_with_permission_only(tmp_path: Path) -> None:
    data = bench_data.make_dataset(tmp_path / "data", 1)
    urdf = tmp_path / "arm.urdf"
    urdf.write_text('<robot name="arm"><link name="a"><visual><geometry><box size="1 1 1"/>'
                    "</geometry></visual></link></robot>")
    shows(data, str(urdf))
    with pytest.raises(ModelError, match=r"arm\.urdf' as its model; add --allow-model"):
        run(data, tmp_path / "results", "Knows")
    assert not (tmp_path / "results").exists()
    run(data, tmp_path / "results", "Good")  # needs no model
    assert run(data, tmp_path / "results", "Knows", allow_model=True).failures == ()


def test_a_dataset_downloads_no_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path / "cache"))
    data = shows(bench_data.make_dataset(tmp_path / "data", 1), "ur5")
    with pytest.raises(ModelError, match="gcbench robots fetch ur5"):
        run(data, tmp_path / "results", "Knows")
    assert not (tmp_path / "cache").exists()
