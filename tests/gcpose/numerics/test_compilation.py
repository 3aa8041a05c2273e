"""Compiled loops give the same bits in the process that compiles them and from the cache."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PROGRAM = """
import hashlib
import numpy as np
from gcbench.gcpose.images import ImageSettings, PredictedPatches, find_patches
from gcbench.gcpose.images.still_camera import appearance

rng, settings = np.random.default_rng(0), ImageSettings()
gray = rng.uniform(0, 255, (90, 110)).astype(np.float32)
v, u = np.mgrid[:90, :110]
images = np.stack([appearance(gray, np.hypot(u - at, v - 45) < 30, settings) for at in (50, 51)])
pixel = rng.uniform(20, 70, (200, 2))
found = find_patches(images, PredictedPatches(
    pixel, np.zeros(200, np.int64), np.repeat(pixel[:, None], 2, axis=1),
    np.broadcast_to(np.eye(2), (200, 2, 2, 2)).copy(), np.ones((200, 2), bool),
    np.ones((200, 2), bool), 4.0), settings)
assert found[1].any()
print(hashlib.sha256(b"".join(array.tobytes() for array in found)).hexdigest())
"""


@pytest.mark.ci
def test_the_first_run_gives_what_the_second_gives(tmp_path: Path) -> None:
    """A loop called another copy of a function in the process that had just compiled it."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run([sys.executable, "-c", PROGRAM], env=environment, check=True,
                       capture_output=True, text=True).stdout for _ in range(2))
    assert first == second
    assert list(tmp_path.rglob("*.nbi"))  # the second run had a cache


def _corner_loop(path: Path) -> Any:
    """The compiled function of a file as another process has it."""
    spec = importlib.util.spec_from_file_location("loops", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.corner


def test_a_process_that_compiles_never_changes_the_code_that_another_loads(tmp_path: Path) -> None:
    """Two compile before either has saved, and a third loads between index and code."""
    path = tmp_path / "loops.py"
    path.write_text("from gcbench.gcpose.numerics import compiled\n\n\n"
                    "@compiled\ndef corner(a):\n    return a[0, 1]\n")
    one, two, three = (_corner_loop(path) for _ in range(3))
    rows = np.arange(6.0).reshape(2, 3)
    columns = np.asfortranarray(rows)
    two._cache._cache_file._load_index = dict  # as it was before the first saved
    cache = three._cache._cache_file
    load = cache._load_data

    def load_late(name: str) -> Any:
        assert two(columns) == 1.0
        return load(name)

    cache._load_data = load_late
    assert one(rows) == 1.0
    assert three(rows) == 1.0
    assert sum(three.stats.cache_hits.values()) == 1
