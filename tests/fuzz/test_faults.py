"""What a killed or failed command leaves, the same command continues; see `actions.py`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from .actions import ACTIONS, mounted

CHECKOUT = Path(__file__).resolve().parents[2]


def faults(*args: str) -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--faults", *args]
    done = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.gl
@pytest.mark.parametrize("fault", ["kill", "full"])
@pytest.mark.ci
def test_one_fault_of_a_render(fault: str) -> None:
    faults("render", "--fault", fault, "--at", "9")


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.parametrize("name", ACTIONS)
def test_every_fault(name: str) -> None:
    """Kills, a full disk and a read-only one, at every change of a file."""
    faults(name)


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.parametrize("name", ACTIONS)
def test_a_real_disk(name: str, tmp_path: Path) -> None:
    """A disk with few blocks left, and a read-only one."""
    try:
        with mounted(tmp_path):
            pass
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no file system can be mounted here ({error})")
    faults(name, "--fault", "disk")
