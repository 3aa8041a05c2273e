"""The program that compares streamed with stored items runs in its short form."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parent / "stream_speed.py"


@pytest.mark.slow
@pytest.mark.gl
def test_the_short_form_measures_both(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="PyTorch is in the extra learn")
    numbers = tmp_path / "numbers.json"
    options = ["--robot", "owi535", "--sequences", "1", "--frames", "3", "--width", "64",
               "--height", "48", "--json", str(numbers)]
    done = subprocess.run(
        [sys.executable, str(PROGRAM), *options], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    turns = json.loads(numbers.read_text())
    assert sorted((turn["source"], turn["items"]) for turn in turns) == [
        ("read", 2), ("streamed", 2)]
