"""Kills at random moments; see `kills.py`.

`python -m tests.fuzz --kills all` runs twenty of each kind.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from .kills import KILLS

CHECKOUT = Path(__file__).resolve().parents[2]
COUNT = os.environ.get("GCBENCH_KILLS", "3")
NEEDS = {"actor": ("ray",), "node": ("ray",), "ray-driver": ("ray",), "server": ("moto", "s3fs"),
         "reader": ("moto", "s3fs")}


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.parametrize("kind", KILLS)
def test_kills_change_nothing(kind: str) -> None:
    """The environment variable GCBENCH_KILLS is their number."""
    for package in NEEDS.get(kind, ()):
        pytest.importorskip(package)
    command = [sys.executable, "-m", "tests.fuzz", "--kills", kind, "--count", COUNT,
               "--sequences", "12"]
    done = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{kind}: {COUNT} kills of " in done.stdout
