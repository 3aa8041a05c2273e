"""What is published works: wheel and sdist on each supported Python, in plain Debian, in Docker."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from .test_architecture import CHECKOUT, build, tomllib

PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
DOCKERFILE = [line.split(" ", 1) for line in (CHECKOUT / "Dockerfile").read_text().splitlines()
              if not line.startswith("#")]
HERE = "{}.{}".format(*sys.version_info[:2])
VERSIONS = ("3.10", "3.11", "3.12", "3.13")
CODE = """
import gcbench as gb
for name in gb.__all__:
    getattr(gb, name)
robot = gb.list_robots()[0]
print(robot.name, gb.__file__)
"""
Run = Callable[..., str]
"""Runs `gcbench` with some arguments where it is installed, and returns what it printed."""


def run(command: list[str], folder: Path, more: Mapping[str, str] | None = None) -> str:
    """Run a command that finds nothing of the checkout, and return what it printed."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | dict(more or {})
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, shlex.join(command) + "\n" + done.stdout + done.stderr
    return done.stdout


def try_out(gcbench: Run) -> None:
    """Do what a new user does first."""
    assert "usage: gcbench" in gcbench("--help")
    assert "ok    drew and checked a frame" in gcbench("doctor")
    size = ["--n", "2", "--frames", "2", "--width", "64", "--height", "48"]
    for robot in ("owi535", "drawer"):
        gcbench("render", "--robot", robot, *size)
        assert "\nok  flow forward" in gcbench("verify", f"data/{robot}")


# -- what it says of itself -------------------------------------------------------------------


def test_the_metadata_is_complete() -> None:
    assert PROJECT["name"] == "gcbench"
    assert PROJECT["authors"] and PROJECT["license"] == "MIT" and PROJECT["keywords"]
    assert {"Homepage", "Documentation", "Source", "Issues", "Changelog"} <= set(PROJECT["urls"])
    prefix = "Programming Language :: Python :: 3."
    minors = [c.removeprefix(prefix) for c in PROJECT["classifiers"] if c.startswith(prefix)]
    assert [f"3.{minor}" for minor in minors] == list(VERSIONS)
    assert PROJECT["requires-python"] == f">={VERSIONS[0]}"


def test_system_packages_agree() -> None:
    """The image, `make` and the pages install the same packages of Debian."""
    places = ("Dockerfile", ".ci/system-libraries", "README.md", "docs/start/install.md")
    for place in places:
        named = set(re.findall(r"\blib[a-z1]+[\w-]*", (CHECKOUT / place).read_text()))
        assert {"libegl1", "libgl1", "libgl1-mesa-dri"} <= named, place


def test_the_dockerfile_has_ten_lines() -> None:
    assert len((CHECKOUT / "Dockerfile").read_text().splitlines()) <= 10


# -- in an environment of its own -------------------------------------------------------------


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The wheel and the sdist of the checkout."""
    pytest.importorskip("hatchling", reason="hatchling builds the wheel and the sdist")
    out: dict[str, Path] = {}
    for kind in ("wheel", "sdist"):
        folder = tmp_path_factory.mktemp(kind)
        build(kind, folder)
        (out[kind],) = folder.iterdir()
    return out


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "version"), [*(("wheel", version) for version in VERSIONS), ("sdist", HERE)]
)
def test_it_installs_and_works(
    kind: str, version: str, built: dict[str, Path], tmp_path: Path
) -> None:
    python = sys.executable if version == HERE else shutil.which(f"python{version}")
    if python is None or subprocess.run([python, "-c", ""], capture_output=True).returncode:
        pytest.skip(f"Python {version} is not installed")
    run([python, "-m", "venv", "env"], tmp_path)
    python, gcbench = (str(tmp_path / "env/bin" / name) for name in ("python", "gcbench"))
    run([python, "-m", "pip", "install", "--quiet", str(built[kind])], tmp_path)
    robot, place = run([python, "-W", "error", "-c", CODE], tmp_path).split()
    assert robot == "ur5" and Path(place).is_relative_to(tmp_path)
    try_out(lambda *args: run([gcbench, *args], tmp_path))


# -- in plain Debian --------------------------------------------------------------------------


@dataclass
class Debian:
    """A Debian of its own with nothing but Python, in which root runs commands."""

    root: Path
    environment: dict[str, str] = field(default_factory=dict[str, str])
    folder: str = "/work"

    def run(self, *command: str) -> str:
        """Run a command in the folder; what is mounted for it goes with it."""
        script = 'mount -t proc proc "$0/proc" && exec chroot "$0" env -C "$@"'
        path = "/env/bin:/usr/sbin:/usr/bin:/sbin:/bin"
        words = ["env", "-i", f"PATH={path}", *(f"{k}={v}" for k, v in self.environment.items())]
        return run(["unshare", "--mount", *words, "sh", "-c", script, str(self.root), self.folder,
                    *command], self.root)


@pytest.fixture(scope="module")
def debian(built: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Debian:
    """Debian after the steps of the Dockerfile, with its own Python in place of the image's."""
    if os.geteuid() != 0 or shutil.which("debootstrap") is None:
        pytest.skip("debootstrap makes the Debian root, and needs root")
    out = tmp_path_factory.mktemp("debian")
    system = Debian(out / "root")
    run(["debootstrap", "--variant=minbase", "--include=python3-venv,ca-certificates", "trixie",
         str(system.root)], out)
    for folder in ("work", "src", "wheels"):
        (system.root / folder).mkdir()
    system.run("python3", "-m", "venv", "/env")
    # pip here loads what pip there installs: the way to the package index need not lead into it
    version = system.run("python3", "-c", "import sys; print('%d.%d' % sys.version_info[:2])")
    run([sys.executable, "-m", "pip", "download", "--quiet", "--python-version", version.strip(),
         "--only-binary=:all:", "--dest", str(system.root / "wheels"), str(built["wheel"]),
         "hatchling"], out)
    system.environment |= {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": "/wheels"}
    for instruction, rest in DOCKERFILE:
        if instruction == "RUN":
            system.run("sh", "-ec", rest)
        elif instruction == "ENV":
            system.environment |= dict(word.split("=", 1) for word in shlex.split(rest))
        elif instruction == "COPY":
            assert rest == ". /src"
            with tarfile.open(built["sdist"]) as archive:
                archive.extractall(out, filter="data")
            (source,) = out.glob("gcbench-*")
            shutil.copytree(source, system.root / "src", dirs_exist_ok=True)
        else:
            assert instruction in ("FROM", "WORKDIR", "ENTRYPOINT")
    return system


@pytest.mark.slow
def test_the_steps_of_the_dockerfile_work_in_debian(debian: Debian) -> None:
    (entry,) = json.loads(dict(DOCKERFILE)["ENTRYPOINT"])  # type: ignore[misc]
    assert not (debian.root / "src").exists()
    try_out(lambda *args: debian.run(entry, *args))


@pytest.mark.slow
def test_the_wheel_works_in_debian(debian: Debian, built: dict[str, Path]) -> None:
    shutil.copy(built["wheel"], debian.root / "wheels")
    debian.run("python3", "-m", "venv", "/wheel")
    debian.run("/wheel/bin/pip", "install", "--quiet", f"/wheels/{built['wheel'].name}")
    elsewhere = replace(debian, folder="/wheel")
    try_out(lambda *args: elsewhere.run("/wheel/bin/gcbench", *args))


# -- in Docker --------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_image_builds_and_works(tmp_path: Path) -> None:
    if shutil.which("docker") is None or subprocess.run(
            ["docker", "info"], capture_output=True).returncode:
        pytest.skip("no Docker engine answers")
    run(["docker", "build", "--tag", "gcbench:test", str(CHECKOUT)], tmp_path)
    user = f"{os.getuid()}:{os.getgid()}"
    image = ["docker", "run", "--rm", "--user", user, "--volume", f"{tmp_path}:/work",
             "gcbench:test"]
    try_out(lambda *args: run([*image, *args], tmp_path))
