"""What `gcbench render` is asked for: configs and options, and what options promise of the data."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench import GcbenchError, open_dataset
from gcbench.__main__ import main
from gcbench.renderer.scene.config import FACTORS, FRONT, STUDIO, RenderConfig, resolve
from gcbench.renderer.types.sequence import Sequence
from gcbench.robots.catalog import find_robot
from gcbench.robots.catalog.entries import robot_folder

from .test_cli import Lines, gcbench_command, one_line

# -- configs: the file's values go before the defaults, the command line's before the file's --


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[RenderConfig, int, Path, int | None]]:
    """What `gcbench render` asks the renderer for, instead of rendering it."""
    calls: list[tuple[RenderConfig, int, Path, int | None]] = []

    class Summary:
        def describe(self) -> str:
            return "done"

    def generate(
        config: RenderConfig, n: int, out: Path, workers: int | None, progress: bool
    ) -> Summary:
        assert progress
        calls.append((config, n, out, workers))
        return Summary()

    monkeypatch.setattr("gcbench.render_dataset", generate, raising=False)
    return calls


Asked = list[tuple[RenderConfig, int, Path, Any]]


def test_defaults(asked: Asked) -> None:
    assert main(["render"]) == 0
    assert asked == [(resolve(RenderConfig()), 10, Path("data/ur5"), None)]


def test_options_reach_the_config(asked: Asked) -> None:
    options = """--robot iiwa14 --n 3 --seed 0 --workers 2 --out x --vary lights motion
        --camera.fov 30 31 --lights.shadows --scored-joints joint_a2 --background.room 1
        --background.kinds plain wood --keep-unobservable --package a=b c=d --animation swing
        --layers normal keypoints --track-points 7 --samples 9"""
    assert main(["render", *options.split()]) == 0
    ((config, n, out, workers),) = asked
    assert (config.robot, n, out, workers) == ("iiwa14", 3, Path("x"), 2)
    assert config.vary == ("lights", "motion")
    assert config.randomization.camera.fov == (30.0, 31.0)
    assert config.randomization.lights.shadows
    assert config.randomization.background.kinds == ("plain", "wood")
    assert config.scored_joints == ("joint_a2",)
    assert config.keep_unobservable
    assert (config.package, config.animation) == (("a=b", "c=d"), "swing")
    assert (config.layers, config.track_points, config.samples) == (("normal", "keypoints"), 7, 9)


TOML = """
robot = "iiwa14"
seed = 5
frames = 3
keep_unobservable = true
[randomization.camera]
fov = [40, 40.5]
"""


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_the_command_line_goes_before_the_file(suffix: str, tmp_path: Path, asked: Asked) -> None:
    path = tmp_path / f"config{suffix}"
    tree = {
        "robot": "iiwa14",
        "seed": 5,
        "frames": 3,
        "keep_unobservable": True,
        "randomization": {"camera": {"fov": [40, 40.5]}},
    }
    path.write_text(TOML if suffix == ".toml" else json.dumps(tree))
    assert main(["render", "--config", str(path), "--frames", "2"]) == 0
    assert (
        main(["render", f"--config={path}", "--no-keep-unobservable", "--camera.roll", "0", "1"])
        == 0
    )
    first, second = (config for config, *_ in asked)
    assert (first.robot, first.seed, first.frames, first.keep_unobservable) == (
        "iiwa14",
        5,
        2,
        True,
    )
    assert first.randomization.camera.fov == (40.0, 40.5)
    assert first.randomization.camera.elevation == RenderConfig().randomization.camera.elevation
    assert first.randomization.lights == RenderConfig().randomization.lights
    assert asked[0][2] == Path("data/iiwa14")
    assert (second.frames, second.keep_unobservable) == (3, False)
    assert second.randomization.camera.fov == (40.0, 40.5)
    assert second.randomization.camera.roll == (0.0, 1.0)


def test_the_draws_of_another_robot_can_be_asked_for(tmp_path: Path, asked: Asked) -> None:
    path = tmp_path / "old.toml"
    path.write_text("seed = 5\n")
    for options in ([], ["--twin-of", "ur5"], ["--twin-of", ""], ["--config", str(path)],
                    ["--config", str(path), "--twin-of", "own"]):
        assert main(["render", "--robot", "iiwa14", *options]) == 0
    assert [config.twin_of for config, *_ in asked] == ["iiwa14", "ur5", "", "", "iiwa14"]


def test_a_studio_is_what_a_file_changes(tmp_path: Path, asked: Asked) -> None:
    path = tmp_path / "config.toml"
    path.write_text("[randomization.lights]\nambient = [0.5, 0.5]\n")
    assert (
        main(["render", "--randomize", "none", "--config", str(path), "--camera.roll", "1", "2"])
        == 0
    )
    assert main(["render", "--randomize=none"]) == 0
    ranges = asked[0][0].randomization
    assert ranges.lights.ambient == (0.5, 0.5)
    assert ranges.lights.number == STUDIO.lights.number
    assert ranges.camera.roll == (1.0, 2.0)
    assert ranges.camera.azimuth == (45.0, 45.0)
    assert asked[1][0] == resolve(RenderConfig(randomization=STUDIO))


def test_a_textured_robot_carries_textures(asked: Asked) -> None:
    assert main(["render", "--robot", "ur5-textured"]) == 0
    assert asked[0][0].randomization.textures.probability == 1.0


@pytest.mark.parametrize("base", [(), ("--randomize", "none")])
def test_an_option_that_equals_its_default_is_given(
    base: tuple[str, ...], tmp_path: Path, asked: Asked
) -> None:
    """The camera of an object stands before its front unless the user says otherwise."""
    path = tmp_path / "config.toml"
    path.write_text("[randomization.camera]\nazimuth = [-180, 180]\n")
    for options in (["--camera.azimuth", "-180", "180"], ["--config", str(path)], []):
        assert main(["render", "--robot", "microwave", *base, *options]) == 0
    given, from_file, default = (c.randomization.camera.azimuth for c, *_ in asked)
    assert given == from_file == (-180.0, 180.0)
    assert default == ((215.0, 215.0) if base else FRONT)
    for options, expected in (["--textures.probability", "0"], 0.0), ([], 1.0):
        assert main(["render", "--robot", "ur5-textured", *base, *options]) == 0
        assert asked[-1][0].randomization.textures.probability == expected


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.toml", "frame = 3", "$.frame: unknown field"),
        ("a.toml", "[randomization.camra]\nfov = [1, 2]", "$.randomization.camra"),
        ("a.toml", "frames = '3'", "$.frames: expected int, got '3'"),
        ("a.toml", "randomization = 3", "randomization"),
        ("a.toml", "frames = ", "not TOML"),
        ("a.toml", "\udcff", "a.toml"),
        ("a.json", "{", "not JSON"),
        ("a.json", "[1]", "a.json"),
        ("a.json", '{"frames": NaN}', "a.json"),
        ("a.json", '{"frames": 0}', "$.frames: 0: give 1"),
    ],
)
def test_a_config_that_cannot_be_meant(
    name: str, text: str, says: str, tmp_path: Path, capsys: Lines
) -> None:
    path = tmp_path / name
    path.write_bytes(text.encode(errors="surrogateescape"))
    assert main(["render", "--config", str(path)]) == 2
    assert says in one_line(capsys)


# -- what the options of `render` promise -----------------------------------------------------


def rendered(out: Path, *options: str, n: int = 2) -> list[Sequence]:
    """Small sequences of a real robot."""
    try:
        robot_folder(find_robot("ur5"))
    except GcbenchError as error:
        pytest.skip(str(error))
    done = gcbench_command(
        "render",
        "--n",
        str(n),
        "--seed",
        "7",
        "--frames",
        "3",
        "--out",
        out,
        "--width",
        "128",
        "--height",
        "96",
        *options,
    )
    assert done.returncode == 0, done.stderr
    return list(open_dataset(out))


def same_truth(a: Sequence, b: Sequence) -> bool:
    """Whether the exact state and the geometric images are equal to the bit."""
    return all(np.array_equal(x, getattr(b.state, k)) for k, x in vars(a.state).items()) and all(
        np.array_equal(getattr(a, k)[:], getattr(b, k)[:], equal_nan=k.startswith("flow"))
        for k in ("depth", "part", "flow", "flow_backward", "visibility")
    )


@pytest.mark.gl
@pytest.mark.ci
def test_twins_differ_in_the_surface_only(tmp_path: Path) -> None:
    plain = rendered(tmp_path / "plain", "--robot", "ur5")
    textured = rendered(tmp_path / "textured", "--robot", "ur5-textured")
    assert len(plain) == len(textured) == 2
    for a, b in zip(plain, textured, strict=True):
        assert same_truth(a, b)
        robot, rest = a.part[0] > 0, a.part[0] == 0
        difference = np.abs(a.rgb[0].astype(int) - b.rgb[0]).max(axis=2)
        assert np.mean(difference[robot] > 8) > 0.5
        assert np.mean(difference[rest] > 0) < 0.1  # antialiased edges, reflections never
    assert not same_truth(plain[0], plain[1])

    assert main(["verify", str(tmp_path / "textured"), "--workers", "1"]) == 0


@pytest.mark.gl
@pytest.mark.ci
def test_a_dataset_of_an_earlier_version_continues_with_its_draws(
    tmp_path: Path, capsys: Lines
) -> None:
    options = ("--robot", "owi535", "--frames", "2")
    expected = rendered(tmp_path / "old", *options, "--twin-of", "")
    assert main(["render", *options, "--out", str(tmp_path / "old")]) == 2
    assert 'twin_of: "" -> "owi535"' in capsys.readouterr().err
    out = Path(shutil.copytree(tmp_path / "old", tmp_path / "out"))
    (out / "sequences" / "000001.zip").unlink()
    tree = json.loads((out / "dataset.json").read_text())
    del tree["config"]["twin_of"]
    (out / "dataset.json").write_text(json.dumps(tree))
    assert all(map(same_truth, rendered(out, *options), expected))


@pytest.mark.gl
def test_vary_lights_changes_the_light_only(tmp_path: Path) -> None:
    first, *others = rendered(tmp_path / "out", "--vary", "lights", n=3)
    for other in others:
        assert same_truth(first, other)
        robot = first.part[0] > 0  # an image behind it is not lit
        assert np.mean(first.rgb[0][robot] != other.rgb[0][robot]) > 0.5
        assert first.meta.randomization != other.meta.randomization
    assert np.any(others[0].rgb[0] != others[1].rgb[0])
    assert set(open_dataset(tmp_path / "out").config.vary) == {"lights"} < set(FACTORS)


@pytest.mark.gl
def test_randomize_none_is_a_plain_studio(tmp_path: Path) -> None:
    a, b = rendered(tmp_path / "out", "--randomize", "none")
    for sequence in (a, b):
        assert np.all(sequence.depth[0][sequence.part[0] == 0] == 0)  # no room
        edge = sequence.rgb[0][0]
        assert np.ptp(edge, axis=0).max() == 0  # one colour
    assert np.array_equal(a.rgb[0][0, 0], b.rgb[0][0, 0])
    assert np.array_equal(a.state.intrinsics, b.state.intrinsics)
    assert np.allclose(a.state.cam_from_world[0, :3, :3], b.state.cam_from_world[0, :3, :3])
    assert not np.array_equal(a.state.joint_positions, b.state.joint_positions)
