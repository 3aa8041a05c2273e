"""The program that compares encoders runs in its short form."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parent / "codec_speed.py"


@pytest.mark.slow
@pytest.mark.gl
def test_the_short_form_compares_every_image() -> None:
    options = ["--robots", "owi535", "--sequences", "1", "--width", "64", "--height", "48"]
    done = subprocess.run(
        [sys.executable, str(PROGRAM), *options], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = [line.split("|")[1].strip() for line in done.stdout.splitlines()[3:]]
    assert rows == ["RGB", "depth", "part", "flow", "flow_backward", "visibility", "all six"]
