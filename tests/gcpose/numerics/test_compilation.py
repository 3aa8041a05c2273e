"""Compiled loops give the same bits in the process that compiles them and from the cache."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

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
    np.broadcast_to(np.eye(2), (200, 2, 2, 2)).copy(), np.ones((200, 2), bool), 4.0), settings)
assert found[1].any()
print(hashlib.sha256(b"".join(array.tobytes() for array in found)).hexdigest())
"""


def test_the_first_run_gives_what_the_second_gives(tmp_path: Path) -> None:
    """A loop called another copy of a function in the process that had just compiled it."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run([sys.executable, "-c", PROGRAM], env=environment, check=True,
                       capture_output=True, text=True).stdout for _ in range(2))
    assert first == second
    assert list(tmp_path.rglob("*.nbi"))  # the second run had a cache
