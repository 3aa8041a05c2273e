"""Data that several trainings learn from."""

from __future__ import annotations

from pathlib import Path

import pytest

from ...support import bench_data


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Two sequences of the stream "train" of an arm that moves."""
    folder = tmp_path / "data"
    folder.mkdir()
    return bench_data.make_dataset(folder, 2, stream="train")
