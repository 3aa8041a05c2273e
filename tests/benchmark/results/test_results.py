"""Results survive a round trip, and what is damaged or means harm is told, not loaded."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from gcbench import DatasetError, GcbenchError
from gcbench.benchmark.results.estimates import (
    EstimateShape,
    InvalidEstimateError,
    Stored,
    dump_stored,
    read_stored,
    validate_estimate,
)
from gcbench.benchmark.results.rows import COLUMNS, Result, Row, write_scores
from gcbench.benchmark.results.runs import SCORES, Results, Run, find_runs, run_folder, write_run
from gcbench.renderer.runtime.zip_archive import ArchiveWriter
from gcbench.renderer.types.observation import Estimate

from ...support.fake_results import GCPOSE, ICP, read_results, write_results

SHAPE = EstimateShape(frames=3, joints=2, height=4, width=5)
ROW = Row("icp", "1.2", "rgbd", "axes", "none", ("true-parts",))
RUN = Run(ROW, "a:B", "mini/ur5", "data/ur5", {"robot": "ur5"}, ({"name": "ur5"},),
          ("000000", "000002"), 1, {"workers": 1}, ({"cores": 2},))
RESULT = Result(
    method="icp@true-parts", version="1.2", inputs="rgbd", knowledge="axes", oracles="true-parts",
    training='supervised: "a", b\n', dataset="mini/ur5", robot="ur5", sequence="000002",
    cluster="000002", joint="pan", joint_index=1, joint_type="revolute", frame=-1,
    metric="final_error", value=0.1234567891, unit="deg", sign="given", status="ok",
)  # fmt: skip


def estimate() -> Estimate:
    rng = np.random.default_rng(0)
    part = rng.integers(0, 3, (3, 4, 5)).astype(np.uint8)
    displacement = rng.normal(size=(3, 2))
    displacement[0], displacement[1, 1] = 0.0, np.nan
    sigma, reliable = np.full((3, 2), np.inf), np.array([True, False])
    return Estimate(displacement, rng.normal(size=(2, 6)), part, sigma, reliable)


def test_scores_come_back(tmp_path: Path) -> None:
    path = tmp_path / "scores.csv"
    write_scores(path, [RESULT, dataclasses.replace(RESULT, joint="", frame=3, value=2e-7)])
    first, second = read_results(path)
    assert dataclasses.replace(first, value=0) == dataclasses.replace(RESULT, value=0)
    assert first.value == pytest.approx(RESULT.value, rel=1e-8)
    assert (second.joint, second.frame, second.value) == ("", 3, 2e-7)


def test_the_frame_holds_every_score(tmp_path: Path) -> None:
    for dataset in ("ur5", "iiwa14"):
        folder = run_folder(tmp_path, ROW, dataset)
        write_run(folder, dataclasses.replace(RUN, dataset=dataset))
        line = dataclasses.replace(RESULT, dataset=dataset, training=ROW.training)
        write_scores(folder / SCORES, [line, dataclasses.replace(line, frame=3, value=2e-7)])
    frame = Results(tuple(find_runs(tmp_path))).frame
    assert tuple(frame.columns) == COLUMNS
    assert len(frame) == 4
    assert frame["value"].sum() == pytest.approx(2 * (RESULT.value + 2e-7), rel=1e-8)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("0.123456789", "zero", r"line 3: Expected `float`, got `str` - at `\$.value`"),
    ("0.123456789", "nan", r"line 3: Expected `float` >= 0.0 - at `\$.value`"),
    ("0.123456789", "inf", r"line 3: \$.value: inf is not a finite number"),
    ("0.123456789", "1e999", r"line 3: Number out of range - at `\$.value`"),
    ("0.123456789", "-1", r"line 3: Expected `float` >= 0.0 - at `\$.value`"),
    ("pan,1,", "pan,one,", r"line 3: Expected `int`, got `str` - at `\$.joint_index`"),
    ("pan,1,", f"pan,{'9' * 400},", r"line 3: .* - at `\$.joint_index`"),
    (",deg,", ",rad,", r"line 3: Invalid enum value 'rad' - at `\$.unit`"),
    (",deg,", ",s,", r"line 3: \$.unit: final_error is in deg or m, got 's'"),
    (",deg,", ",m,", r"line 3: \$.unit: final_error of a revolute joint is in deg, got 'm'"),
    ("0.123456789", "1e308", r"line 3: \$.value: 1e\+308 is larger than 1e\+12"),
    ("method,", "methods,", "line 1: the first line is not method,"),
    (",ok", "", "line 3: 18 cells instead of 19"),
    ("000002", "&amp;", r"line 3: Expected `str` matching regex .* - at `\$.sequence`"),
])  # fmt: skip
def test_a_damaged_table_names_its_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "scores.csv"
    write_scores(path, [RESULT])
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(GcbenchError, match=message):
        read_results(path)


@pytest.mark.parametrize(("change", "message"), [
    ({}, r"two lines have final_error of joint pan in sequence 000000; delete the table, and run"),
    ({"method": "icp"}, r"line [0-9]+: \$\.method: it is not 'gcpose' as in run\.json; delete"),
    ({"version": "9"}, r"\$\.version: it is not '1\.0' as in run\.json"),
    ({"inputs": "rgb"}, r"\$\.inputs: it is not 'rgbd'"),
    ({"knowledge": "free"}, r"\$\.knowledge: it is not 'axes'"),
    ({"oracles": "true-parts"}, r"\$\.oracles: it is not ''"),
    ({"training": "x"}, r"\$\.training: it is not 'none'"),
    ({"dataset": "oven"}, r"\$\.dataset: it is not 'ur5'"),
    ({"sequence": "000077"}, r"\$\.sequence: 000077 is not in run\.json; delete the table"),
])  # fmt: skip
def test_lines_that_are_not_those_of_the_run_are_refused(
    tmp_path: Path, change: dict[str, str], message: str
) -> None:
    path = write_results(tmp_path, GCPOSE, 0.01, sequences=3, joints=("pan", "lift"))
    lines = read_results(path / SCORES)
    first = next(line for line in lines if line.metric == "final_error")
    write_scores(path / SCORES, [*lines, dataclasses.replace(first, **change)])
    (run,) = find_runs(tmp_path)
    with pytest.raises(DatasetError, match=message) as error:
        run.scores()
    assert "\n" not in str(error.value)


def test_a_very_short_screw_is_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "scores.csv"
    far = dataclasses.replace(RESULT, metric="axis_distance", value=1.7e18, unit="m")
    sure = dataclasses.replace(RESULT, metric="sigma", value=float("inf"))
    write_scores(path, [far, sure])
    assert [line.value for line in read_results(path)] == [1.7e18, float("inf")]


@pytest.mark.parametrize("name", ["run.json", "scores.csv"])
def test_a_pipe_in_place_of_a_file_is_refused(tmp_path: Path, name: str) -> None:
    write_run(tmp_path, RUN)
    write_scores(tmp_path / SCORES, [RESULT])
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    with pytest.raises(DatasetError, match=rf"{name}: is not a regular file"):
        find_runs(tmp_path)[0].results()


def test_runs_come_back_and_are_found(tmp_path: Path) -> None:
    folder = run_folder(tmp_path, ROW, RUN.dataset)
    assert folder == tmp_path / "icp@true-parts_rgbd_axes" / "mini" / "ur5"
    write_run(folder, RUN)
    (found,) = find_runs(tmp_path)
    assert (found.path, found.run) == (folder, RUN)
    with pytest.raises(GcbenchError, match="no such folder"):
        find_runs(tmp_path / "nowhere")


def test_linked_folders_are_found_once(tmp_path: Path) -> None:
    """A results folder may be collected from several disks by links."""
    write_results(tmp_path / "disk", ICP, 0.02, "ur5", scores=False)
    real = write_results(tmp_path / "results", GCPOSE, 0.02, "ur5", scores=False)
    (tmp_path / "results/icp_rgbd_axes").symlink_to(tmp_path / "disk/icp_rgbd_axes")
    (tmp_path / "results/a").symlink_to(real.parent)  # what is there without it
    (tmp_path / "results/b").symlink_to(tmp_path / "results")  # a loop
    (tmp_path / "results/c").symlink_to(tmp_path / "nowhere")
    (tmp_path / "disk/icp_rgbd_axes/back").symlink_to(tmp_path / "disk")
    assert [run.path for run in find_runs(tmp_path / "results")] == [
        real, tmp_path / "results/icp_rgbd_axes/ur5"]


@pytest.mark.parametrize(("change", "message"), [
    ({"format": "x"}, "format is 'x'"),
    ({"sequences": ["../../etc"]}, r"\$\.sequences\[0\]: expected str matching"),
    ({"sequences": ["000000\n"]}, r"\$\.sequences\[0\]: expected str matching"),
    ({"row": []}, r"\$\.row: expected object"),
    ({"row": {**dataclasses.asdict(ROW), "inputs": "x"}}, r"\$\.row\.inputs: expected one of none"),
    ({"config": 3}, r"\$\.config: expected object, got 3"),
    ({"assets": [1]}, r"\$\.assets\[0\]: expected object, got 1"),
    ({"surplus": 1}, r"\$\.surplus: unknown field; there are row, source"),
    ({"dataset": 7}, r"\$\.dataset: expected str, got 7"),
    ({"left_out": -1}, r"\$\.left_out: expected int >= 0, got -1"),
])  # fmt: skip
def test_an_invalid_run_is_refused_by_file_and_field(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    write_run(tmp_path, RUN)
    tree = json.loads((tmp_path / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps(tree | change))
    with pytest.raises(DatasetError, match=rf"run\.json: {message}"):
        find_runs(tmp_path)


def test_rows_have_folders_of_their_own() -> None:
    names = ["a/b", "a-b", "../x", "..", "ä" * 300, "a b", "CON?", ".hidden"]
    folders = {dataclasses.replace(ROW, method=name).folder for name in names}
    assert len(folders) == len(names)
    assert all(not f.startswith(".") and "/" not in f and len(f) < 200 for f in folders)


def test_estimates_come_back(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    path.write_bytes(dump_stored(Stored("ok", "", 1.5, 20.0, estimate())))
    got = read_stored(path, SHAPE)
    assert (got.status, got.seconds, got.peak_memory) == ("ok", 1.5, 20.0)
    assert got.estimate is not None
    for field in dataclasses.fields(Estimate):
        np.testing.assert_array_equal(
            getattr(got.estimate, field.name), getattr(estimate(), field.name))
    assert dump_stored(got) == path.read_bytes()
    path.write_bytes(dump_stored(Stored("timeout", "x" * 10_000)))
    failed = read_stored(path, SHAPE)
    assert (failed.status, len(failed.reason), failed.estimate) == ("timeout", 4000, None)


@pytest.mark.parametrize(("change", "message"), [
    ({"displacement": np.zeros((3, 1))}, r"displacement is float64 \[3, 1\], expected .*\[3 2\]"),
    ({"displacement": np.zeros((3, 2), complex)}, "displacement is complex128"),
    ({"displacement": np.array([[object()] * 2] * 3)}, "displacement is object"),
    ({"displacement": [[1], [1, 2], []]}, "displacement is not an array"),
    ({"displacement": None}, "displacement is None"),
    ({"screw": np.zeros((6, 2))}, r"screw .*\[J 6\] = \[2 6\]"),
    ({"sigma": np.zeros(3)}, r"sigma .*\[T J\]"),
    ({"sigma": np.array([[0, 0], [1, -0.5], [1, 1.0]])}, "sigma has -0.5, expected no negative"),
    ({"displacement": np.full((3, 2), 0.5)}, "displacement of frame 0 is 0.5, expected 0: displ"),
    ({"reliable": np.ones((3, 2), bool)}, r"reliable is bool \[3, 2\], expected bool \[J\]"),
    ({"reliable": np.ones(2)}, r"reliable is float64 \[2\], expected bool \[J\] = \[2\]"),
    ({"part": np.zeros((3, 4, 5))}, "part is float64"),
    ({"part": np.full((3, 4, 5), 3)}, r"labels outside 0\.\.2"),
    ({"part": np.full((3, 4, 5), -1)}, r"labels outside 0\.\.2"),
])  # fmt: skip
def test_what_is_no_estimate_is_told(change: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidEstimateError, match=message):
        validate_estimate(dataclasses.replace(estimate(), **change), SHAPE)  # type: ignore[arg-type]


def archive(path: Path, arrays: bytes, **changes: object) -> Path:
    tree = {"format": "gcbench-estimate/2", "status": "ok", "reason": "", "seconds": 1.0,
            "peak_memory": None} | changes  # fmt: skip
    with path.open("wb") as file:
        writer = ArchiveWriter(file)
        writer.add("estimate.json", json.dumps(tree).encode())
        writer.add("estimate.npz", arrays)
        writer.close()
    return path


def test_estimates_of_the_former_format_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    moved = np.ones((3, 2))
    moved[0] = 0.0
    arrays = npz(displacement=npy(moved), sigma=npy(np.ones((3, 2))))
    got = read_stored(archive(path, arrays, format="gcbench-estimate/1"), SHAPE).estimate
    assert got is not None
    assert (got.displacement == moved).all() and got.reliable is None
    with pytest.raises(DatasetError, match=r"format is 'gcbench-estimate/3'; .*gcbench-estimate/2"):
        read_stored(archive(path, arrays, format="gcbench-estimate/3"), SHAPE)


def npz(**members: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            file.writestr(f"{name}.npy", data)
    return out.getvalue()


def npy(array: np.ndarray, **options: bool) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array(out, array, version=(1, 0), **options)  # type: ignore[arg-type]
    return out.getvalue()


def test_harm_is_not_loaded(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    good = npy(np.zeros((3, 2)))

    def refused(arrays: bytes, message: str, **changes: object) -> None:
        with pytest.raises(GcbenchError, match=message):
            read_stored(archive(path, arrays, **changes), SHAPE)

    assert read_stored(archive(path, npz(displacement=good)), SHAPE).status == "ok"
    objects = npy(np.array([[{}] * 2] * 3), allow_pickle=True)
    refused(npz(displacement=objects), "displacement is object")
    refused(pickle.dumps("x"), "not a whole NPZ")
    refused(npz(displacement=good, part=b"\0" * 10_000_000), "part is larger than")
    lying = good.replace(b"(3, 2)", b"(9, 9)")
    refused(npz(displacement=lying), r"float64 \[9, 9\], expected .*\[3, 2\]")
    refused(npz(displacement=good[:-8]), "header does not fit")
    refused(npz(screw=npy(np.zeros((2, 6)))), "no displacement")
    refused(npz(displacement=good, other=good), "unknown array 'other'")
    refused(npz(displacement=good)[:-30], "not a whole NPZ")
    refused(npz(displacement=good), "status: expected one of ok", status="perfect")
    refused(npz(displacement=good), "seconds: expected float", seconds="fast")
