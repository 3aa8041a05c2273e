"""The wheel installs and works on every supported Python that this machine has."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from .test_architecture import build

CODE = """
import gcbench as gb
for name in gb.__all__:
    getattr(gb, name)
robot = gb.list_robots()[0]
print(robot.name)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("hatchling", reason="hatchling builds the wheel")
    folder = tmp_path_factory.mktemp("wheel")
    build("wheel", folder)
    (path,) = folder.iterdir()
    return path


@pytest.mark.slow
@pytest.mark.parametrize("version", ["3.10", "3.11", "3.12", "3.13"])
def test_it_installs_and_imports(version: str, wheel: Path, tmp_path: Path) -> None:
    python = shutil.which(f"python{version}")
    here = "{}.{}".format(*sys.version_info[:2]) == version
    if not here and (python is None or subprocess.run([python, "-c", ""]).returncode):
        pytest.skip(f"Python {version} is not installed")
    run([sys.executable if here else str(python), "-m", "venv", str(tmp_path / "env")])
    python = str(tmp_path / "env/bin/python")
    run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", str(wheel)])
    assert run([python, "-W", "error", "-c", CODE]) == "ur5\n"
    assert "usage: gcbench" in run([str(tmp_path / "env/bin/gcbench"), "--help"])
    size = ["--n", "1", "--frames", "2", "--width", "64", "--height", "48"]
    render = [str(tmp_path / "env/bin/gcbench"), "render", "--robot", "owi535", *size]
    run([*render, "--out", str(tmp_path / "data")])


def run(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
