"""The speed program runs in its short form; contenders that are not installed are left out."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parent / "render_speed.py"
OURS = ("Shipped", "Encoded", "Pure", "Images")


@pytest.mark.gl
@pytest.mark.ci
def test_the_short_form_measures_what_is_installed(tmp_path: Path) -> None:
    numbers = tmp_path / "numbers.json"
    options = ["--robot", "owi535", "--sequences", "1", "--frames", "3", "--worker-sequences", "0"]
    done = subprocess.run(
        [sys.executable, str(PROGRAM), *options, "--json", str(numbers)],
        capture_output=True, text=True,
    )
    assert done.returncode == 0, done.stderr
    left_out = [line for line in done.stdout.splitlines() if line.startswith("left out: ")]
    assert "left out: Pyrender: ValueError: owi535 has no URDF file" in left_out
    if find_spec("pybullet") is None:
        assert "left out: Bullet: not installed (pybullet)" in left_out
    found = json.loads(numbers.read_text())
    assert set(found["contenders"]) >= set(OURS)
    assert len(found["contenders"]) + len(left_out) == 8
    measured = {turn["contender"]: turn["frames"] for turn in found["turns"]}
    assert measured == dict.fromkeys(found["contenders"], 3)
    rows = [line.split("|")[1].strip() for line in done.stdout.splitlines() if "ms |" in line]
    assert "written" in rows and not any(row.startswith("pyrender script") for row in rows)
    assert "Traceback" not in done.stderr


@pytest.mark.gl
@pytest.mark.slow
def test_runs_of_several_processes_are_measured(tmp_path: Path) -> None:
    numbers = tmp_path / "numbers.json"
    options = ["--robot", "owi535", "--sequences", "0", "--frames", "2", "--worker-sequences", "6",
               "--rounds", "1", "--json", str(numbers)]
    done = subprocess.run(
        [sys.executable, str(PROGRAM), *options], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rates = json.loads(numbers.read_text())["workers"]
    assert set(rates) >= {"one", "local", "shards"}
    assert ("ray" in rates, "stream" in rates) == (bool(find_spec("ray")), bool(find_spec("torch")))
    assert all(rate > 0 for kind in rates.values() for rate in kind)


def test_the_table_of_the_documentation_is_the_program_s() -> None:
    """It is copied from what `make speed` prints, on a machine of two cores."""
    page = (PROGRAM.parents[2] / "docs/benchmark/performance.md").read_text()
    code = "import json, render_speed; print(json.dumps([*render_speed.TITLES.values()]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                          cwd=PROGRAM.parent)
    missing = [title for title in json.loads(done.stdout)
               if f"\n| {title.format(2)} | " not in page]
    assert not missing
