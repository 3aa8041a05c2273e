"""The command line as its users meet it: help, one-line errors, configs, what options promise."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gcbench
import numpy as np
import pytest
from gcbench import GcbenchError, open_dataset
from gcbench import __main__ as command_line
from gcbench.__main__ import COMMANDS, main
from gcbench.renderer.config import FACTORS, STUDIO, RenderConfig
from gcbench.renderer.doctor import EXTRAS, PACKAGES
from gcbench.renderer.sequence import Sequence
from gcbench.robots import catalog
from gcbench.robots.appliances import GENERATED

Lines = pytest.CaptureFixture[str]

URDF = """<robot name="pointer">
  <link name="base"><visual><geometry><box size="0.3 0.3 0.1"/></geometry></visual></link>
  <link name="hand"><visual><origin xyz="0.3 0 0.1"/>
    <geometry><box size="0.6 0.1 0.05"/></geometry></visual></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="hand"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 0 1"/><limit lower="-2" upper="2"/></joint>
</robot>"""


def gcbench_command(*args: str | Path, timeout: float = 300) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gcbench", *map(str, args)],
        capture_output=True,
        text=True,
        timeout=timeout,
    )


# -- help -------------------------------------------------------------------------------------


@pytest.mark.parametrize("args", [[], ["-h"], ["--help"], ["help"]])
def test_help_names_every_command(args: list[str], capsys: Lines) -> None:
    assert main(args) == 0
    said = capsys.readouterr().out
    for command in COMMANDS:
        assert re.search(rf"^  {command} +\S", said, re.MULTILINE)
    assert "examples:\n  gcbench " in said


@pytest.fixture
def parses(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], bool]:
    """Whether a line's options are understood; nothing is done."""

    def parse(*args: Any) -> None:
        understood(*args)
        raise KeyboardInterrupt

    understood = command_line._parse
    monkeypatch.setattr(command_line, "_parse", parse)
    return lambda line: main(shlex.split(line, comments=True)[1:]) == 130


@pytest.mark.parametrize("command", [*COMMANDS, "robots fetch"])
@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_a_command_s_help_has_examples_that_parse(
    command: str, flag: str, parses: Callable[[str], bool], capsys: Lines
) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*command.split(), flag])
    assert not stop.value.code
    said, errors = capsys.readouterr()
    assert not errors
    assert f"usage: gcbench {command}" in said
    examples = re.findall(rf"^  (gcbench {command}(?! fetch).*)", said, re.MULTILINE)
    assert examples
    for example in examples:
        assert parses(example), capsys.readouterr().err


@pytest.mark.parametrize("page", ["README.md", "docs/export.md"])
def test_the_commands_of_the_docs_parse(
    page: str, parses: Callable[[str], bool], capsys: Lines, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    text = (Path(__file__).parents[1] / page).read_text()
    examples = re.findall(rf"^gcbench (?:{'|'.join(COMMANDS)}) .*", text, re.MULTILINE)
    assert len(examples) > 2
    (tmp_path / "lab.toml").touch()
    monkeypatch.chdir(tmp_path)
    for example in examples:
        assert parses(example), (example, capsys.readouterr().err)


def test_help_answers_at_once() -> None:
    """It loads nothing that takes long to load."""
    code = ("import sys; from gcbench.__main__ import main; main(['--help']); "
            "print(*{'numpy', 'cv2', 'tyro', 'pandas', 'torch'} & {*sys.modules}, file=sys.stderr)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "usage: gcbench" in done.stdout
    assert not done.stderr.strip()


def test_version(capsys: Lines) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"gcbench {gcbench.__version__}\n"


# -- errors -----------------------------------------------------------------------------------


def one_line(capsys: Lines) -> str:
    """The one line of stderr; nothing else was said."""
    said, errors = capsys.readouterr()
    assert not said
    assert errors.startswith("gcbench: ")
    assert errors.endswith("\n")
    assert errors.count("\n") == 1, errors
    return errors


@pytest.mark.parametrize(
    ("args", "says"),
    [
        ("frobnicate", "render, verify, show, robots, doctor"),
        ("--frobnicate", "render, verify, show, robots, doctor"),
        ("render --frame 3", "--frames"),
        ("render --n three", "'three'"),
        ("render --n", "--n"),
        ("render --n 0", "1 or more"),
        ("render --n 1 --workers 0", "1 or more"),
        ("render --workers x", "--workers"),
        ("render extra", "extra"),
        ("render --seed -1", "--seed -1"),
        ("render --frames 0", "--frames 0"),
        ("render --width 8", "--width 8"),
        ("render --height 99999", "--height 99999"),
        ("render --samples 3", "'1', '4', '9'"),
        ("render --stream validation", "'test', 'train'"),
        ("render --randomize some", "'full', 'none'"),
        ("render --vary lights moon", "motion, camera, lights, materials"),
        ("render --camera.fov 30", "--camera.fov"),
        ("render --camera.fov 50 30", "smaller number first"),
        ("render --camera.fov nan nan", "--camera.fov nan nan"),
        ("render --camera.fov 30 inf", "--camera.fov 30 inf"),
        ("render --materials.probability 2", "--materials.probability 2: give 0 to 1"),
        ("render --robot ur6", "ur5, ur5-textured, iiwa14, irb2400"),
        ("render --config nowhere.toml", "nowhere.toml: No such file"),
        ("verify", "PATH"),
        ("verify nowhere", "nowhere"),
        ("verify nowhere --workers 0", "1 or more"),
        ("show nowhere", "nowhere"),
        ("show nowhere.zip", "nowhere.zip"),
        ("show nowhere --open --gif x.gif", "--out PAGE.html"),
        ("robots fly", "fly"),
        ("robots fetch", "--all"),
        ("robots fetch ur6", "ur5, ur5-textured, iiwa14, irb2400"),
        ("robots fetch microwave", "an object has nothing to fetch"),
        ("doctor who", "who"),
    ],
)
def test_errors_are_one_line(
    args: str, says: str, capsys: Lines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(args.split()) == 2
    assert says in one_line(capsys)
    assert not list(tmp_path.rglob("*.zip"))


@pytest.mark.parametrize(
    ("urdf", "says"),
    [
        (None, "o such file"),
        ("<robot", "model.urdf"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><robot name="a"><link name="&b;"/></robot>', "model.urdf"),
        (URDF.replace('size="0.6', 'size="nan'), "nan"),
        (URDF.replace('<box size="0.6 0.1 0.05"/>', '<mesh filename="a.exe"/>'), "a.exe"),
        (URDF.replace('<box size="0.6 0.1 0.05"/>', '<mesh filename="lost.stl"/>'), "lost.stl"),
        (URDF.replace('<box size="0.6 0.1 0.05"/>', '<mesh filename="/etc/a.stl"/>'), "/etc/a.stl"),
        (URDF.replace('child link="hand"', 'child link="base"'), "joint"),
    ],
)
@pytest.mark.gl
def test_a_broken_model_is_one_line(urdf: str | None, says: str, tmp_path: Path) -> None:
    path = tmp_path / "model.urdf"
    if urdf is not None:
        path.write_text(urdf)
    done = gcbench_command(
        "render",
        "--robot",
        path,
        "--n",
        "1",
        "--frames",
        "2",
        "--out",
        tmp_path / "out",
        "--width",
        "64",
        "--height",
        "48",
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("gcbench: ")
    assert done.stderr.count("\n") == 1, done.stderr
    assert says in done.stderr
    assert "model.urdf" in done.stderr
    assert not list(tmp_path.rglob("*.zip"))


def test_ctrl_c_is_no_error(capsys: Lines, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(args: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setitem(COMMANDS, "doctor", stopped)
    assert main(["doctor"]) == 130
    assert "continues where it was" in one_line(capsys)


def test_a_reader_that_leaves_early_is_no_error() -> None:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "gcbench", "robots"]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, env=environment)
    os.close(write)
    assert done.returncode == 141
    assert not done.stderr


# -- configs: the file's values go before the defaults, the command line's before the file's --


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[RenderConfig, int, Path, int | None]]:
    """What `gcbench render` asks the renderer for, instead of rendering it."""
    calls: list[tuple[RenderConfig, int, Path, int | None]] = []

    class Summary:
        def describe(self) -> str:
            return "done"

    def generate(config: RenderConfig, n: int, out: Path, workers: int | None = None) -> Summary:
        calls.append((config, n, out, workers))
        return Summary()

    monkeypatch.setattr("gcbench.renderer.generate.generate", generate)
    return calls


Asked = list[tuple[RenderConfig, int, Path, Any]]


def test_defaults(asked: Asked) -> None:
    assert main(["render"]) == 0
    assert asked == [(RenderConfig(), 10, Path("data/ur5"), None)]


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
    assert ranges.camera.azimuth == STUDIO.camera.azimuth
    assert asked[1][0].randomization == STUDIO


def test_a_textured_robot_carries_textures(asked: Asked) -> None:
    assert main(["render", "--robot", "ur5-textured"]) == 0
    assert asked[0][0].randomization.textures.probability == 1.0


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.toml", "frame = 3", "'frame'"),
        ("a.toml", "[randomization.camra]\nfov = [1, 2]", "'camra'"),
        ("a.toml", "frames = '3'", "frames is '3'"),
        ("a.toml", "randomization = 3", "randomization"),
        ("a.toml", "frames = ", "not TOML"),
        ("a.toml", "\udcff", "a.toml"),
        ("a.json", "{", "not JSON"),
        ("a.json", "[1]", "a.json"),
        ("a.json", '{"frames": NaN}', "a.json"),
        ("a.json", '{"frames": 0}', "--frames 0"),
    ],
)
def test_a_config_that_cannot_be_meant(
    name: str, text: str, says: str, tmp_path: Path, capsys: Lines
) -> None:
    path = tmp_path / name
    path.write_bytes(text.encode(errors="surrogateescape"))
    assert main(["render", "--config", str(path)]) == 2
    assert says in one_line(capsys)


# -- robots and doctor ------------------------------------------------------------------------


def test_robots_are_listed(capsys: Lines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path))
    assert main(["robots"]) == 0
    head, *rows = capsys.readouterr().out.splitlines()
    assert head.split() == ["name", "robot", "joints", "scored", "licence", "fetched", "source"]
    assert [row.split()[0] for row in rows] == [
        *(entry.name for entry in catalog.CATALOG), *GENERATED, "partnet:7310"]
    for row, entry in zip(rows, catalog.CATALOG, strict=False):
        assert entry.maker in row
        assert entry.licence in row
        made = isinstance(entry, catalog.Generated)
        assert ("generated" if made else entry.files.requirement) in row
        assert re.search(rf" {entry.joints} .* {'yes' if made else 'no'} ", row)


def test_fetch_says_where_the_files_are(capsys: Lines, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalog, "fetch", lambda entry: Path("cache") / entry.name)  # type: ignore[misc]
    assert main(["robots", "fetch", "--all"]) == 0
    assert capsys.readouterr().out == "".join(
        f"{e.name}: generated, nothing to fetch\n" if isinstance(e, catalog.Generated)
        else f"{e.name}: cache/{e.name}\n"
        for e in catalog.CATALOG
    )  # fmt: skip


@pytest.mark.gl
def test_doctor_is_content_with_this_machine(capsys: Lines) -> None:
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^  ok +drew and checked a frame in .*OpenGL", said, re.MULTILINE)
    assert "ur5" in said
    for name in (*PACKAGES, *EXTRAS):
        assert re.search(rf"^  (ok|none)  +{name}[ :]", said, re.MULTILINE), name


def test_doctor_fails_where_nothing_renders(capsys: Lines, monkeypatch: pytest.MonkeyPatch) -> None:
    from gcbench.renderer import gl, rasterizer

    def fail(*_: object) -> None:
        raise gl.NoRendererError("no device")

    monkeypatch.setattr(rasterizer, "Rasterizer", fail)
    monkeypatch.setattr(gl, "device_names", fail)
    assert main(["doctor"]) == 2
    said = capsys.readouterr().out
    assert "FAIL  no device" in said
    assert "Traceback" not in said


# -- what the options of `render` promise -----------------------------------------------------


def rendered(out: Path, *options: str, n: int = 2) -> list[Sequence]:
    """Small sequences of a real robot."""
    try:
        catalog.fetch(catalog.find("ur5"))
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


@pytest.mark.gl
def test_show_writes_what_is_asked_for(
    tmp_path: Path, capsys: Lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    rendered(tmp_path / "out")
    capsys.readouterr()
    monkeypatch.chdir(tmp_path)
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    args = ["show", "out", "--index", "1", "--out", "a.html", "--contact-sheet", "a.png"]
    assert main([*args, "--gif", "a.gif", "--mp4", "a.mp4", "--open"]) == 0
    assert capsys.readouterr().out.split() == ["a.html", "a.png", "a.gif", "a.mp4"]
    assert Path("a.gif").read_bytes()[:3] == b"GIF"
    assert Path("a.mp4").read_bytes()[4:8] == b"ftyp"
    assert opened == [(tmp_path / "a.html").as_uri()]
    assert main(["show", "out"]) == 0
    assert capsys.readouterr().out.split() == ["ur5_7_000000.html"]
    assert main(["show", "out", "--index", "9"]) == 2
    assert "000000 to 000001" in one_line(capsys)
