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
def test_the_short_form_measures_what_is_installed(tmp_path: Path) -> None:
    numbers = tmp_path / "numbers.json"
    options = ["--robot", "owi535", "--sequences", "1", "--frames", "3", "--worker-sequences", "0"]
    done = subprocess.run(
        [sys.executable, str(PROGRAM), *options, "--json", str(numbers)],
        capture_output=True, text=True,
    )
    assert done.returncode == 0, done.stderr
    left_out = [line for line in done.stdout.splitlines() if line.startswith("left out: ")]
    assert "left out: pyrender script: ValueError: owi535 has no URDF file" in left_out
    if find_spec("pybullet") is None:
        assert "left out: PyBullet TinyRenderer: not installed (pybullet)" in left_out
    found = json.loads(numbers.read_text())
    assert set(found["contenders"]) >= set(OURS)
    assert len(found["contenders"]) + len(left_out) == 7
    measured = {turn["contender"]: turn["frames"] for turn in found["turns"]}
    assert measured == dict.fromkeys(found["contenders"], 3)
    table = done.stdout[done.stdout.index("frames/s") :]
    assert "pyrender script: all" not in table
    assert "Traceback" not in done.stderr
