"""Predictions from elsewhere: the truth is perfect, and a wrong file is told the format."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.__main__ import main
from gcbench.benchmark.report.leaderboard import build_leaderboard
from gcbench.benchmark.results.rows import Result
from gcbench.benchmark.results.runs import RUN, find_runs, read_run
from gcbench.benchmark.run import submissions
from gcbench.benchmark.run.driver import EvalConfig, evaluate
from gcbench.benchmark.run.submissions import PREDICTIONS_FORMAT, ScoreConfig, score_predictions
from gcbench.renderer.dataset.reader import open_dataset

from ...support import bench_data

HEADER = "# method: mine\n# inputs: rgbd\n# knowledge: free\n# training: none\n"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bench_data.make_dataset(tmp_path_factory.mktemp("data") / "arm", 2)


def csv_of(data: Path, change: Callable[[np.ndarray], np.ndarray] = lambda q: q) -> str:
    lines = [HEADER + "sequence,frame,joint,displacement"]
    for index in range(2):
        q = change(bench_data.truth(data, index))
        lines += [f"{index:06d},{t},{j + 1},{q[t, j]!r}".replace("np.float64(", "").rstrip(")")
                  for t in range(1, len(q)) for j in range(2)]
    return "\n".join(lines) + "\n"


def score(file: Path, data: Path, tmp_path: Path) -> list[Result]:
    (folder,) = submissions.score(file, data, tmp_path / "results").runs
    return folder.results()


def finals(results: list[Result]) -> list[float]:
    return [r.value for r in results if r.metric == "final_error"]


@pytest.mark.parametrize(("change", "expected"), [
    (lambda q: q, 0.0),
    (lambda q: -q, 0.0),  # at `free` and without an axis the sign is a gauge
    (lambda q: q + 0.01 * np.sign(q[-1]), np.degrees(0.01)),
    (lambda q: q + 2 * np.pi, 0.0),
])
def test_truth_flip_and_offset(
    data: Path, tmp_path: Path, change: Callable[[np.ndarray], np.ndarray], expected: float
) -> None:
    file = tmp_path / "mine.csv"
    file.write_text(csv_of(data, change))
    results = score(file, data, tmp_path)
    np.testing.assert_allclose(finals(results), expected, atol=1e-6)
    (line,) = build_leaderboard(find_runs(tmp_path / "results")).lines
    assert (line.row.name, line.row.inputs, line.row.knowledge) == ("mine", "rgbd", "free")
    assert line.summary.pcp == ((100,) * 4)
    assert line.sign == "best"
    assert "seconds_per_frame" not in line.means


def test_an_npz_may_hold_axes(data: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.npz"
    q = [bench_data.truth(data, i) for i in range(2)]
    screw = [open_dataset(data)[i].state.joint_screw[0, :2] for i in range(2)]
    header = {"method": "mine", "inputs": "rgb", "knowledge": "free", "training": "none"}
    np.savez(file, **header, **{  # type: ignore[arg-type]
        "000000": -q[0], "000000.screw": -screw[0], "000001": -q[1], "000001.screw": screw[1]})
    results = score(file, data, tmp_path)
    got = finals(results)
    np.testing.assert_allclose(got[:2], 0, atol=1e-9)
    np.testing.assert_allclose(got[2:], 2 * np.degrees(np.abs(q[1][-1])))  # the axis says the sign
    np.testing.assert_allclose(
        [r.value for r in results if r.metric == "axis_direction"], 0, atol=1e-6)
    np.savez(file, **header, **{"000000": q[0]})  # type: ignore[arg-type]
    with pytest.raises(GcbenchError, match=r"6 targets are missing: 000001 \(all\)"):
        score(file, data, tmp_path)
    np.savez(file, **header, **{"000000": np.array([{}])})  # type: ignore[arg-type]
    with pytest.raises(GcbenchError, match="is object"):
        score(file, data, tmp_path)
    np.savez(file, **header, **{"000000": q[0][:2]})  # type: ignore[arg-type]
    with pytest.raises(GcbenchError, match=r"000000 is float64 \[2, 2\], expected .*\[4, 2\]"):
        score(file, data, tmp_path)


def test_nan_is_an_answer_that_failed(data: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.csv"
    text = csv_of(data).splitlines()
    text[-1] = text[-1].rsplit(",", 1)[0] + ",nan"
    file.write_text("\n".join(text))
    results = score(file, data, tmp_path)
    assert [r.value for r in results if r.metric == "covered"] == [1, 1, 1, 0]
    assert finals(results)[3] == [r.value for r in results if r.metric == "displacement"][3]


@pytest.mark.parametrize(("old", "new", "message"), [
    ("# method: mine\n", "", "the header does not say method"),
    ("rgbd", "lidar", "inputs: expected one of none, rgb, rgbd, rgbd-noise, got 'lidar'"),
    ("knowledge: free", "knowledge: none", "do not go together"),
    ("knowledge: free", "knowledge: free\n# knowledge: axes", "knowledge is there twice"),
    ("training: none", "training: none\n# colour: red", "the header says 'colour'"),
    ("method: mine", "method: mine@true-parts", "without @"),
    ("displacement", "angle", "line 5: 'sequence,frame,joint,angle' instead of sequence,frame"),
    ("000000,1,1,", "000009,1,1,", "line 6: no sequence '000009'; there are 000000 to 000001"),
    ("000000,1,1,", "000000,4,1,", "line 6: frame is '4', expected 0 to 3"),
    ("000000,1,1,", "000000,1,0,", "line 6: joint is '0', expected 1 to 2, "),
    ("000000,1,1,", "000000,1,lid,", "line 6: joint is 'lid', expected 1 to 2, pan"),
    ("000000,1,2,", "000000,1,1,", "line 7: 000000, frame 1, joint 1 is there twice"),
    ("000000,1,1,", "000000,1,1,0.1,", "line 6: 5 cells instead of 4"),
    ("000000,1,1,", "000000,1,1,x", "line 6: displacement is 'x"),
    ("000000,1,1,", '"000000,1,1,', "unexpected end of data"),
])
def test_a_wrong_file_is_told_the_format(
    data: Path, tmp_path: Path, old: str, new: str, message: str
) -> None:
    file = tmp_path / "mine.csv"
    file.write_text(csv_of(data).replace(old, new, 1))
    with pytest.raises(GcbenchError, match=message) as error:
        score(file, data, tmp_path)
    assert PREDICTIONS_FORMAT in str(error.value)
    assert not (tmp_path / "results").exists()


def test_each_missing_target_is_listed(data: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.csv"
    lines = csv_of(data).splitlines()
    file.write_text("\n".join([*lines[:6], *lines[7:11]]))
    with pytest.raises(GcbenchError) as error:
        score(file, data, tmp_path)
    assert ("7 targets are missing: 000000 frame 1 joint 2, 000001 (all); every one must be there"
            in str(error.value))


@pytest.mark.parametrize("harm", [b"", b"\0" * 100, b"PK\3\4rest", b"\xff\xfe\x00", b"#" * 10_000])
def test_what_is_no_file_of_ours_is_refused(data: Path, tmp_path: Path, harm: bytes) -> None:
    file = tmp_path / "mine.csv"
    file.write_bytes(harm)
    with pytest.raises(GcbenchError, match="expected a CSV"):
        score(file, data, tmp_path)
    with pytest.raises(GcbenchError, match="no such file"):
        score(tmp_path / "none.csv", data, tmp_path)


def test_a_new_file_replaces_the_old_one(data: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.csv"
    file.write_text(csv_of(data, lambda q: q + 0.01 * np.sign(q[-1])))
    assert max(finals(score(file, data, tmp_path))) > 0.5
    file.write_text(csv_of(data))
    assert max(finals(score(file, data, tmp_path))) < 1e-6


def test_absolute_angles_are_refused(data: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.csv"
    file.write_text(csv_of(data) + "000001,0,2,0.25\n")
    with pytest.raises(GcbenchError, match=r"000001: displacement of frame 0 is 0\.25, ex"):
        score(file, data, tmp_path)
    assert not (tmp_path / "results").exists()
    file.write_text(csv_of(data) + "000001,0,2,0\n")
    assert max(finals(score(file, data, tmp_path))) < 1e-6


def test_displacements_in_degrees_are_doubted(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mine.csv"
    file.write_text(csv_of(data, lambda q: q + 2 * np.pi))
    score(file, data, tmp_path)
    assert not capsys.readouterr().err
    file.write_text(csv_of(data, np.degrees))
    score(file, data, tmp_path)
    said = capsys.readouterr().err
    assert "are these degrees? displacements are in rad" in said and said.count("\n") == 1
    assert f"{file}: sequence 000000: joint " in said


@pytest.mark.parametrize("name", ["hold-still", "screwnet microwave width=16", "gcpose"])
def test_predictions_do_not_take_the_name_of_a_method_of_gcbench(
    data: Path, tmp_path: Path, name: str
) -> None:
    file = tmp_path / "mine.csv"
    file.write_text(csv_of(data).replace("mine", name))
    with pytest.raises(GcbenchError, match="is a method of gcbench: choose another name, such as"):
        score(file, data, tmp_path)
    assert not (tmp_path / "results").exists()


def test_a_part_of_the_sequences_is_scored(data: Path, tmp_path: Path) -> None:
    file, results = tmp_path / "mine.csv", tmp_path / "results"
    text = csv_of(data)
    file.write_text("\n".join(x for x in text.splitlines() if not x.startswith("000001,")) + "\n")
    for chosen in {"sequences": "0"}, {"limit": 1}:
        config = ScoreConfig(file, data=(data,), results=results, **chosen)
        (found,) = score_predictions(config).runs
        assert found.run.sequences == ("000000",) and max(finals(found.results())) < 1e-6
    with pytest.raises(GcbenchError, match="targets are missing: 000001"):
        score(file, data, tmp_path)
    with pytest.raises(GcbenchError, match="--limit must be 0 or more"):
        score_predictions(ScoreConfig(file, data=(data,), results=results, limit=-1))


def test_several_datasets_have_names(data: Path, tmp_path: Path) -> None:
    other = bench_data.make_dataset(tmp_path / "other", 1)
    file = tmp_path / "mine.csv"
    text = csv_of(data).replace("\n00000", "\narm/00000")
    text += "".join(line.replace("arm/000000", "other/000000") + "\n"
                    for line in text.splitlines() if line.startswith("arm/000000"))
    file.write_text(text)
    config = ScoreConfig(file, data=(data, other), results=tmp_path / "results")
    folders = score_predictions(config).runs
    assert [f.run.dataset for f in folders] == ["arm", "other"]
    assert all(max(finals(f.results())) < 1e-6 for f in folders)


def test_estimates_of_a_method_are_kept_under_the_name_with_the_seed(
    data: Path, tmp_path: Path
) -> None:
    """Which a dataset gets beside another of its name."""
    other = bench_data.make_dataset(tmp_path / "arm", 2)
    tree = json.loads((other / "dataset.json").read_text())
    tree["config"]["seed"] = 8
    (other / "dataset.json").write_text(json.dumps(tree))
    file, results = tmp_path / "mine.csv", tmp_path / "results"
    named = HEADER.replace("rgbd", "none").replace("free", "none")
    own = tmp_path / "own.py"
    own.write_text("from gcbench.benchmark.methods.baselines import HoldStill\n"
                   "class Own(HoldStill):\n    name = 'mine'\n")
    file.write_text(csv_of(data).replace(HEADER, named))
    score(file, data, tmp_path)
    config = EvalConfig(method=(f"{own}:Own",), data=(other,), results=results, workers=1)
    (found,) = evaluate(config, progress=False).runs
    assert found.path.name == "arm-seed-8"
    with pytest.raises(GcbenchError, match="arm-seed-8 holds estimates of mine"):
        score(file, other, tmp_path)
    assert read_run(found.path / RUN).source == f"{own}:Own" and found.results()
    score(file, data, tmp_path)


def test_a_prediction_that_is_not_scored_is_told_why(data: Path, tmp_path: Path) -> None:
    hidden = bench_data.make_dataset(tmp_path / "hidden", 2, unobservable=(1,))
    file, results = tmp_path / "mine.csv", tmp_path / "results"
    file.write_text(csv_of(hidden))
    said = "sequence {}000001: it is not scored, because its motion .* --keep-unobservable"
    with pytest.raises(GcbenchError, match=said.format("")):
        score(file, hidden, tmp_path)
    config = ScoreConfig(file, data=(hidden,), results=results, keep_unobservable=True)
    (found,) = score_predictions(config).runs
    assert max(finals(found.results())) < 1e-6
    text = csv_of(data)
    file.write_text(text.replace("\n00000", "\narm/00000")
                    + "hidden/000001,1,1,0\nhidden/000009,1,1,0\n")
    with pytest.raises(GcbenchError, match=said.format("hidden/")):
        score_predictions(ScoreConfig(file, data=(data, hidden), results=results))


def test_the_command_line_scores(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, results = tmp_path / "mine.csv", tmp_path / "results"
    file.write_text(csv_of(data))
    arguments = ["--data", str(data), "--results", str(results)]
    assert main(["score", "--predictions", str(file), *arguments]) == 0
    out = capsys.readouterr().out
    assert "mean (deg)" in out and "0 to 0" not in out
    assert "100.0 %" in out
    file.write_text("sequence\n")
    assert main(["score", "--predictions", str(file), *arguments]) == 2
    assert "expected a CSV" in capsys.readouterr().err
