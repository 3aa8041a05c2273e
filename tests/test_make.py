"""The make targets and the programs in .ci run, at least in a short form.

`make test`, `make lint` and `make docs` run in CI; the speed program has a test beside it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[1]
MAKEFILE = (CHECKOUT / "Makefile").read_text()
pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


def make(*args: str, folder: Path) -> str:
    """Run the checkout's Makefile in a folder, with this Python and without remaking it."""
    command = ["make", "-f", str(CHECKOUT / "Makefile"), "-o", "package", f"PY={sys.executable}"]
    done = subprocess.run([*command, *args], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with what the recipes call."""
    shutil.copy(CHECKOUT / "pyproject.toml", tmp_path)
    shutil.copytree(CHECKOUT / ".ci", tmp_path / ".ci")
    (tmp_path / ".venv").mkdir()
    return tmp_path


def test_help_lists_every_target(folder: Path) -> None:
    said = make("help", folder=folder)
    listed = set(re.findall(r"^([a-z-]+) ", said, re.MULTILINE))
    targets = set(re.search(r"^\.PHONY: (.*)", MAKEFILE, re.MULTILINE)[1].split())  # type: ignore[index]
    assert targets - listed == {"package", "libraries"}
    assert listed <= targets


@pytest.mark.gl
@pytest.mark.ci
def test_the_demo_makes_what_it_names(tmp_path: Path) -> None:
    demo = [str(CHECKOUT / ".ci/demo"), sys.executable, "owi535", "1"]
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(demo, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    named = re.findall(r"^(?:Contact sheet|Page|Leaderboard): +(.*)", done.stdout, re.MULTILINE)
    assert len(named) == 3
    assert all(Path(file).is_file() for file in named)


@pytest.mark.gl
@pytest.mark.slow
def test_appliances_are_rendered_and_verified(folder: Path) -> None:
    make("appliances", "N=1", folder=folder)
    assert len(list(folder.glob("demo/*.png"))) == 4


@pytest.mark.gl
@pytest.mark.ci
def test_fuzz_runs_cases(folder: Path) -> None:
    shutil.copytree(CHECKOUT / "tests", folder / "tests")
    said = make("fuzz", "ARGS=configuration results --count 1", folder=folder)
    for kind in ("configuration", "results"):
        assert re.search(rf"^{kind}: 1 cases, [01] of them accepted, 0 findings, seed 1$", said,
                         re.MULTILINE)


def test_clean_leaves_data(folder: Path) -> None:
    for name in ("demo", "build", "data", "robots/__pycache__"):
        (folder / name).mkdir(parents=True)
    make("clean", folder=folder)
    assert {p.name for p in folder.iterdir()} == {".ci", "pyproject.toml", "data", "robots"}
    assert not list((folder / "robots").iterdir())


def test_programs_are_sound_shell() -> None:
    for program in (CHECKOUT / ".ci").iterdir():
        subprocess.run(["bash", "-n", str(program)], check=True)
        assert os.access(program, os.X_OK), program
