"""A motion from a file is replayed as it stands, or refused in one line."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.errors import ConfigError
from gcbench.renderer.generate.driver import render_dataset, render_sequence
from gcbench.renderer.scene.config import MotionConfig, RandomizationConfig, RenderConfig
from gcbench.renderer.scene.models import model_source
from gcbench.renderer.scene.recorded_motion import read_motion
from gcbench.robots.catalog import load_robot

TIMES = np.linspace(2.0, 3.0, 11)
ELBOW = 0.2 + 0.6 * (TIMES - 2.0)
BASE = -0.1 - 0.4 * (TIMES - 2.0) ** 2


def csv_of(folder: Path, header: str = "time,elbow,base") -> Path:
    path = folder / "joints.csv"
    rows = [f"{t!r},{e!r},{b!r}" for t, e, b in zip(*map(np.ndarray.tolist, (TIMES, ELBOW, BASE)),
                                                   strict=True)]
    path.write_text("\n".join(["# of a test", header, *rows, ""]))
    return path


def config_of(path: Path, **changes: object) -> RenderConfig:
    ranges = replace(RandomizationConfig(), motion=MotionConfig(file=str(path), fps=20.0))
    config = RenderConfig("owi535", frames=5, width=64, height=48, randomization=ranges)
    return replace(config, **changes)


def test_csv_and_npz_say_the_same(tmp_path: Path) -> None:
    npz = tmp_path / "joints.npz"
    np.savez_compressed(npz, times=TIMES, positions=np.stack([ELBOW, BASE], 1),
                        joints=np.array(["elbow", "base"]))
    one, two = read_motion(csv_of(tmp_path)), read_motion(npz)
    assert one.joints == two.joints == ("elbow", "base")
    assert one.positions.tobytes() == two.positions.tobytes()
    assert one.times.tobytes() == two.times.tobytes()


def test_positions_are_interpolated_and_other_joints_rest(tmp_path: Path) -> None:
    model = load_robot("owi535")
    motion = read_motion(csv_of(tmp_path)).trajectory(model, 21, 20.0)
    names = model.joint_names
    np.testing.assert_allclose(motion.positions[::2, names.index("base")], BASE, atol=1e-12)
    np.testing.assert_allclose(motion.positions[1, names.index("elbow")], 0.23, atol=1e-12)
    others = [j for j, name in enumerate(names) if name not in ("base", "elbow")]
    assert (motion.positions[:, others] == 0).all()
    np.testing.assert_allclose(motion.times, np.arange(21) / 20.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the first column is ''"),
        ("elbow,time\n1,2\n", "the first column is 'elbow'"),
        ("time,elbow\n\n", "there are no rows"),
        ("time,elbow\n0,1,2\n", "row 1 has 3 values, the header has 2"),
        ("time,elbow\n0,x\n", "could not convert string 'x'"),
        ("time,elbow\n0,1\n1\n", "row 2 has 1 values, the header has 2"),
        ("time,elbow\n0,nan\n", "a number that is not finite"),
        ("time,elbow\n0,1\n0,1\n", "times that do not ascend"),
        ("time,elbow,elbow\n0,1,1\n", "a joint twice"),
        ("time\n0\n", "has 0 columns"),
        ("\xff\xfe", "codec can't decode"),
    ],
)
def test_a_wrong_csv_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "x.csv"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError, match=message) as caught:
        read_motion(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_a_wrong_npz_is_one_line(tmp_path: Path) -> None:
    good = {"times": TIMES, "positions": np.zeros((11, 1)), "joints": np.array(["elbow"])}
    for change in ({"times": None}, {"times": np.zeros((2, 2))}, {"joints": np.array([1.0])},
                   {"positions": np.zeros((10, 1))}, {"positions": np.zeros((11, 1), complex)}):
        path = tmp_path / "x.npz"
        np.savez(path, **{k: v for k, v in (good | change).items() if v is not None})
        with pytest.raises(ConfigError, match="expected a CSV") as caught:
            read_motion(path)
        assert "\n" not in str(caught.value)
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("times.npy", bytes(2**27))
    path.write_bytes(bomb.getvalue())
    with pytest.raises(ConfigError, match="larger than"):
        read_motion(path)


def test_what_the_robot_cannot_do_is_refused(tmp_path: Path) -> None:
    model = load_robot("owi535")
    with pytest.raises(ConfigError, match="no joint 'knee' of its own; there are"):
        read_motion(csv_of(tmp_path, "time,elbow,knee")).trajectory(model, 3, 30.0)
    motion = read_motion(csv_of(tmp_path))
    with pytest.raises(ConfigError, match="lasts 1 s, which is 21 frames at 20 per second"):
        motion.trajectory(model, 22, 20.0)
    with pytest.raises(ConfigError, match=r"elbow is at 9\.24 in frame 2, outside its limits"):
        replace(motion, positions=motion.positions + 9.0).trajectory(model, 3, 30.0)


def test_scored_joints_are_those_that_the_file_moves(tmp_path: Path) -> None:
    config = config_of(csv_of(tmp_path))
    assert model_source(config, 0).scored == ("base", "elbow")
    chosen = replace(config, scored_joints=("elbow",))
    assert model_source(chosen, 0).scored == ("elbow",)
    assert model_source(config, 0).asset["motion"]["file"] == "joints.csv"


@pytest.mark.gl
def test_every_sequence_replays_the_file(tmp_path: Path) -> None:
    config = config_of(csv_of(tmp_path))
    one, two = render_sequence(config, 0), render_sequence(config, 1)
    names = one.meta.joint_names
    for sequence in (one, two):
        found = sequence.state.joint_positions
        np.testing.assert_allclose(found[:, names.index("elbow")], 0.2 + 0.03 * np.arange(5))
    assert not np.array_equal(one.state.cam_from_world, two.state.cam_from_world)


@pytest.mark.gl
@pytest.mark.ci
def test_another_file_is_another_dataset(tmp_path: Path) -> None:
    path, out = csv_of(tmp_path), tmp_path / "out"
    config = config_of(path, frames=2)
    render_dataset(config, 1, out, 1, progress=False)
    path.write_text(path.read_text().replace("2.1,", "2.11,"))
    with pytest.raises(GcbenchError, match=r"other model files \(motion\.sha256 changed"):
        render_dataset(config, 2, out, 1, progress=False)
