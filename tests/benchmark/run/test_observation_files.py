"""An exported observation is what `observe` gives, and nothing tells the truth."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import cv2
import numpy as np
import pytest
from gcbench import GcbenchError, export_observations, open_dataset
from gcbench.__main__ import main
from gcbench.benchmark.protocol import observe
from gcbench.renderer.types import Observation

from ...support import bench_data


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bench_data.make_dataset(tmp_path_factory.mktemp("data") / "arm", 2)


def read(folder: Path) -> dict[str, object]:
    """The fields of an observation, without gcbench."""
    found = json.loads((folder / "observation.json").read_text())
    if (folder / "depth.npy").exists():
        found["depth"] = np.load(folder / "depth.npy")
    images = sorted((folder / "rgb").iterdir())
    found["rgb"] = np.stack([cv2.imread(str(file))[..., ::-1] for file in images])
    return found


@pytest.mark.parametrize(("track", "knowledge", "granted"), [
    ("rgb", "free", set()),
    ("rgbd", "axes", {"depth", "cam_from_world", "axis_direction"}),
    ("rgbd-noise", "kinematics", {"depth", "cam_from_world", "axis_direction", "axis_line"}),
])
def test_files_hold_exactly_the_observation(
    dataset: Path, tmp_path: Path, track: str, knowledge: str, granted: set[str]
) -> None:
    out = export_observations(dataset, tmp_path / "o", track, knowledge, progress=False).folder
    always = {"rgb", "intrinsics", "times", "n_joints", "joint_types", "joint_parent",
              "depth_noise"}
    for name, sequence in zip(("000000", "000001"), open_dataset(dataset), strict=True):
        found = read(out / name)
        assert set(found) == always | granted
        expected = observe(sequence, track, knowledge)
        for field in fields(Observation):
            value = getattr(expected, field.name)
            assert (value is None) == (field.name not in found), field.name
            if value is not None:
                np.testing.assert_array_equal(found[field.name], value)
                assert not isinstance(value, np.ndarray) or field.name not in ("rgb", "depth") \
                    or found[field.name].dtype == value.dtype


def test_texts_and_open_datasets_are_taken(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for k, given in enumerate((open_dataset(dataset), str(dataset))):
        done = export_observations(given, f"o{k}", sequences="0", progress=False)
        assert (done.folder, done.sequences) == (Path(f"o{k}"), 1)


def test_nothing_tells_the_truth(dataset: Path, tmp_path: Path) -> None:
    """The seed or the configuration would: with them, one can render the sequence again."""
    args = ["export", str(dataset), "--format", "observation", "--track", "rgbd-noise"]
    assert main([*args, "--knowledge", "axes", "--out", str(tmp_path / "o")]) == 0
    files = {p.relative_to(tmp_path / "o").as_posix() for p in (tmp_path / "o").rglob("*.*")}
    frames = {f"{s}/rgb/{t:06d}.png" for s in ("000000", "000001") for t in range(4)}
    assert files == frames | {f"{s}/{name}" for s in ("000000", "000001")
                              for name in ("depth.npy", "observation.json")} | {"export.json"}
    told = json.loads((tmp_path / "o/export.json").read_text())
    assert set(told) == {"generator", "assets", "format", "track", "knowledge", "sequences"}
    assert told["assets"] == [{"name": "arm", "licence": "MIT"}]


@pytest.mark.parametrize(("track", "knowledge"), [
    ("none", "none"), ("rgbd", "model"), ("rgbd", "none"), ("lidar", "axes")])
def test_what_cannot_be_exported_is_refused(
    dataset: Path, tmp_path: Path, track: str, knowledge: str
) -> None:
    with pytest.raises(GcbenchError, match="tracks: rgb, rgbd, rgbd-noise; knowledge: free"):
        export_observations(dataset, tmp_path / "o", track, knowledge, progress=False)
    assert not list(tmp_path.iterdir())


def test_the_options_belong_to_the_format(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(dataset), "--format", "kitti", "--track", "rgb"]) == 2
    assert "--format observation" in capsys.readouterr().err
