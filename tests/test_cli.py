"""The command line as its users meet it: help, one-line errors, robots, the doctor."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gcbench
import pytest
from gcbench.__main__ import COMMANDS, main
from gcbench.benchmark import commands
from gcbench.benchmark.methods.registry import METHODS
from gcbench.renderer.doctor import EXTRAS, PACKAGES
from gcbench.renderer.generate import options
from gcbench.renderer.runtime import command_line
from gcbench.renderer.verify.checks import CheckResult, VerifyReport
from gcbench.robots.appliances.generator import GENERATED
from gcbench.robots.catalog import CATALOG
from gcbench.robots.catalog.entries import GeneratedRobot

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


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_a_command_s_help_has_examples_that_parse(
    command: str, flag: str, parses: Callable[[str], bool], capsys: Lines
) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*command.split(), flag])
    assert not stop.value.code
    said, errors = capsys.readouterr()
    assert not errors
    (usage,) = re.findall(rf"^usage: gcbench {command}(.*)", said, re.MULTILINE)
    assert usage.count("[") == usage.count("]")
    examples = re.findall(rf"^  (gcbench {command}(?! fetch).*)", said, re.MULTILINE)
    assert examples
    for example in examples:
        assert parses(example), capsys.readouterr().err


def test_a_default_that_depends_on_the_robot_is_in_words(capsys: Lines) -> None:
    with pytest.raises(SystemExit):
        main(["render", "--help", "all"])
    said = capsys.readouterr().out
    assert "--camera.azimuth FLOAT FLOAT" in said
    assert "None" not in said


def options_in(text: str) -> list[str]:
    return re.findall(r"(?m)^  (?:-h, )?(--[\w.-]+)", text)


@pytest.mark.parametrize(
    ("command", "usual", "group"),
    [("render", ["--robot", "--n", "--out"], "camera"), ("eval", ["--method", "--suite"], "limit"),
     ("train flow", ["--data", "--out"], "loss")],
)
def test_help_begins_with_the_usual_options(
    command: str, usual: list[str], group: str, capsys: Lines
) -> None:
    said: dict[str, str] = {}
    for wanted in ("", "all", group):
        with pytest.raises(SystemExit):
            main([*command.split(), "--help", *filter(None, [wanted])])
        said[wanted] = capsys.readouterr().out
    short, every, some = (options_in(text) for text in said.values())
    assert short[:len(usual) + 1] == ["--help", *usual]
    assert len(short) <= 16 or command == "train flow"
    assert set(some).isdisjoint(short) and {*short, *some} < set(every)
    assert len(every) == len(set(every))
    more = said[""].partition("more options")[2]
    assert re.search(rf"(?m)^  {group} +{some[0]} ", more)
    for k, option in enumerate(every):  # each option is explained or named
        assert k < len(short) or re.search(rf"{option}|{option[option.find('.'):]}[ \n]", more)


def test_every_option_of_a_group_exists(capsys: Lines) -> None:
    for command, groups in (("render", options._GROUPS), ("eval", commands._GROUPS)):
        with pytest.raises(SystemExit):
            main([command, "--help", "all"])
        assert {*" ".join(groups.values()).split()} <= {*options_in(capsys.readouterr().out)}


def test_help_says_what_may_be_repeated(capsys: Lines) -> None:
    with pytest.raises(SystemExit):
        main(["robots", "fetch", "--help"])
    assert "\nusage: gcbench robots fetch [STR ...] [--all]\n" in capsys.readouterr().out


@pytest.mark.parametrize("group", ["camra", "ur5"])
def test_help_of_no_group(group: str, capsys: Lines) -> None:
    assert main(["render", "--help", group]) == 2
    assert f"--help {group}: no group of options" in one_line(capsys)


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
        ("frobnicate", "render, submit, export, robots, robots fetch, show, verify"),
        ("--completion fish", "bash, zsh, tcsh"),
        ("verfy data", "no command 'verfy' (perhaps you meant verify); there are"),
        ("render --robot iiwa7", "no robot 'iiwa7' (perhaps you meant iiwa14); there are"),
        ("render --robot /", "/ is no model; name a .urdf, .glb or .gltf file"),
        ("render --robot microwav", "(perhaps you meant microwave)"),
        ("eval --method gcpos", "no method 'gcpos' (perhaps you meant gcpose); there are"),
        ("eval --method gcpose --suite papr", "no suite 'papr' (perhaps you meant paper)"),
        ("--frobnicate", "render, submit, export, robots, robots fetch, show, verify"),
        ("render --frame 3", "--frames"),
        ("render --n three", "'three'"),
        ("render --n", "--n"),
        ("render --n 0", "1 or more"),
        ("render --n 1 --workers -1", "1 or more, or 0 for one for each core"),
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
        ("render --config nowhere.toml", "nowhere.toml: cannot be read (No such file"),
        ("verify", "PATH"),
        ("verify nowhere", "nowhere"),
        ("verify nowhere --workers -1", "1 or more"),
        ("show nowhere", "nowhere"),
        ("show nowhere.zip", "nowhere.zip"),
        ("show nowhere --open --gif x.gif", "--out PAGE.html"),
        ("robots fly", "fly"),
        ("export nowhere --format exr", "kitti, bop, coco"),
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


def test_a_terminal_obeys_no_name(
    tmp_path: Path, capsys: Lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names of files and inside files may hold escapes, marks of direction and lone surrogates."""
    name = tmp_path / "a\x1b[31m\u202eb\udcff"
    assert main(["verify", str(name)]) == 2
    assert r"a\x1b[31m\u202eb\udcff" in one_line(capsys)
    error = gcbench.ModelError("part \x07\u20ac\n\tline")
    assert str(error) == "part \\x07\u20ac\n\tline"
    check = CheckResult("flow", 1.0, 1.0, 0.0, "px", 1, "part \x1b]0;x\x07")
    monkeypatch.setattr(gcbench, "verify_dataset", lambda *_, **__: VerifyReport((check,)))
    assert main(["verify", "data"]) == 1
    assert r"part \x1b]0;x\x07" in capsys.readouterr().out


def test_what_an_encoding_lacks_is_escaped() -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    command = [sys.executable, "-m", "gcbench", "verify", "\u20ac"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 2 and done.stderr.startswith("gcbench: \\u20ac")


def test_ctrl_c_is_no_error(capsys: Lines, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(args: object) -> tuple[object, int]:
        raise KeyboardInterrupt

    monkeypatch.setitem(COMMANDS, "doctor", stopped)
    assert main(["doctor"]) == 130
    assert "the same command again" in one_line(capsys)


def test_a_reader_that_leaves_early_is_no_error() -> None:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "gcbench", "robots"]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, env=environment)
    os.close(write)
    assert done.returncode == 141
    assert not done.stderr


@pytest.mark.parametrize("closed", ["", " 2>&-"])
def test_a_crash_of_a_library_says_where(closed: str) -> None:
    code = ("import os, signal; from gcbench.__main__ import COMMANDS, main; "
            "COMMANDS['doctor'] = lambda *_: os.kill(os.getpid(), signal.SIGSEGV); main()")
    done = subprocess.run(["bash", "-c", f'"$0" -c "$1" doctor{closed}', sys.executable, code],
                          capture_output=True, text=True)
    assert done.returncode in (-signal.SIGSEGV, 128 + signal.SIGSEGV)
    assert closed or "Segmentation fault" in done.stderr
    assert closed or 'line 1 in <lambda>' in done.stderr


# -- robots and doctor ------------------------------------------------------------------------


def test_robots_are_listed(capsys: Lines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path))
    assert main(["robots"]) == 0
    head, *rows = capsys.readouterr().out.splitlines()
    assert head.split() == ["name", "robot", "joints", "scored", "licence", "fetched", "source"]
    assert [row.split()[0] for row in rows] == [
        *(entry.name for entry in CATALOG), *GENERATED, "partnet:7310"]
    for row, entry in zip(rows, CATALOG, strict=False):
        assert entry.maker in row
        assert entry.licence in row
        made = isinstance(entry, GeneratedRobot)
        assert ("generated" if made else entry.files.requirement) in row
        assert re.search(rf" {entry.joints} .* {'yes' if made else 'no'} ", row)


def test_fetch_says_where_the_files_are(capsys: Lines, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "gcbench.robots.catalog.listing.robot_folder", lambda entry: Path("cache") / entry.name)
    assert main(["robots", "fetch", "--all"]) == 0
    assert main(["robots", "fetch", "owi535"]) == 0
    assert capsys.readouterr().out == "".join(
        f"{e.name}: cache/{e.name}\n" for e in CATALOG if e.name != "owi535"
    ) + "owi535: generated, nothing to fetch\n"


@pytest.mark.gl
def test_doctor_is_content_with_this_machine(
    capsys: Lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EXTRAS, "no-such-package", "learn")
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^  ok +drew and checked a frame in .*OpenGL", said, re.MULTILINE)
    assert "ur5" in said and "-m pip install no-such-package, if you want it" in said
    for name in (*PACKAGES, *EXTRAS):
        assert re.search(rf"^  (ok|none)  +{name}[ :]", said, re.MULTILINE), name


def test_doctor_fails_where_nothing_renders(capsys: Lines, monkeypatch: pytest.MonkeyPatch) -> None:
    from gcbench.renderer import gl

    def fail(*_: object) -> None:
        raise gl.NoRendererError("no device")

    monkeypatch.setattr(gl, "Rasterizer", fail)
    monkeypatch.setattr(gl, "device_names", fail)
    assert main(["doctor"]) == 2
    said = capsys.readouterr().out
    assert "FAIL  no device" in said
    assert "Traceback" not in said


def test_methods_and_suites_are_listed(capsys: Lines) -> None:
    assert main(["methods"]) == 0
    head, *rows = capsys.readouterr().out.splitlines()
    assert head.split() == ["method", "inputs", "knowledge", "training"]
    assert [row.split()[0] for row in rows][-len(METHODS):] == list(METHODS)
    assert main(["suites"]) == 0
    head, *rows = capsys.readouterr().out.splitlines()
    assert head.split() == ["suite", "version", "datasets", "sequences", "about"]
    assert [row.split()[0] for row in rows] == ["mini", "paper", "standard"]


# -- for scripts ------------------------------------------------------------------------------


def parsed(capsys: Lines, *args: str | Path, code: int = 0) -> Any:
    """The one JSON document that a command prints; it says nothing else."""
    assert main([*map(str, args), "--json"]) == code
    said, errors = capsys.readouterr()
    assert not errors
    return json.loads(said, parse_constant=pytest.fail)


def test_lists_are_json(capsys: Lines) -> None:
    robots = parsed(capsys, "robots")
    assert [robot["name"] for robot in robots][:2] == ["ur5", "ur5-textured"]
    assert [m["method"] for m in parsed(capsys, "methods")][-len(METHODS):] == list(METHODS)
    assert [suite["suite"] for suite in parsed(capsys, "suites")] == ["mini", "paper", "standard"]


@pytest.mark.gl
def test_commands_answer_with_json(capsys: Lines, tmp_path: Path) -> None:
    """`--quiet` keeps the plan and the progress away."""
    data, results = tmp_path / "data", tmp_path / "results"
    size = ("--frames", "5", "--width", "128", "--height", "96", "--workers", "1")
    render = ("render", "--robot", "owi535", "--n", "1", "--out", data, *size)
    done = parsed(capsys, *render, "--quiet")
    assert (done["dataset"], done["sequences"], done["frames"]) == (str(data), 1, 5)
    checked = parsed(capsys, "verify", data, "--workers", "1", "--quiet")
    assert checked["ok"] is True
    assert all(check["worst"] <= check["bound"] for check in checked["checks"])
    method = ("eval", "--method", "hold-still", "--data", data, "--results", results)
    ran = parsed(capsys, *method, "--quiet")
    (line,) = ran["leaderboard"]
    assert (line["method"], line["sequences"], line["ci_low"]) == ("hold-still", 1, None)
    assert (ran["estimated"], ran["usable"], ran["failures"]) == (1, 1, [])
    assert Path(ran["folders"][0]).is_dir() and Path(ran["pages"][0]).is_file()

    template = tmp_path / "new.csv"
    score = ("score", "--predictions", template, "--data", data, "--results", results)
    assert parsed(capsys, *score, "--template", "--quiet") == {"template": str(template)}
    text = template.read_text().replace("NAME", "mine")
    template.write_text(re.sub(r"(?m)^(\d{6},.*,)$", r"\g<1>0.0", text))
    scored = parsed(capsys, *score, "--quiet")
    assert scored["leaderboard"][0]["mean"] == pytest.approx(line["mean"])
    written = parsed(capsys, "report", results, "--out", tmp_path / "report", "--no-pictures",
                     "--quiet")
    assert all(Path(written[key]).is_file() for key in ("page", "markdown", "csv", "latex"))


@pytest.mark.gl
def test_the_doctor_answers_with_json(capsys: Lines) -> None:
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["ok"] is True
    assert any(line.startswith("ok    numpy ") for line in found["packages"])


def test_what_json_lacks_is_null() -> None:
    check = CheckResult("flow", float("inf"), float("nan"), 0.0, "px", 1, "part \udcff")
    record = json.loads(command_line.to_json({"checks": (check,), "path": Path("a")}))
    assert record["checks"][0] | {"worst": None, "mean": None} == record["checks"][0]
    assert record["path"] == "a"


# -- completion -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def completion() -> str:
    return gcbench_command("--completion", "bash").stdout


@pytest.mark.parametrize(
    ("line", "completed"),
    [
        ("ver", {"verify"}),
        ("render --camera.f", {"--camera.fov", "--camera.fill"}),
        ("verify --allow", {"--allow-model"}),
        ("train f", {"flow", "foreground"}),
        ("train flow --step", {"--steps"}),
        ("eval --knowledge ki", {"kinematics"}),
    ],
)
def test_bash_completes(line: str, completed: set[str], completion: str) -> None:
    words = ["gcbench", *line.split()]
    script = (f"{completion}\nCOMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}\n"
              "_tyro_gcbench; printf '%s\\n' \"${COMPREPLY[@]}\"")
    done = subprocess.run(["bash"], input=script, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == completed
