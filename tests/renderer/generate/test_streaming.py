"""A stream gives the items of a stored dataset, to each rank and worker its share."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import gcbench as gb
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is in the extra learn")

CONFIG = gb.RenderConfig(
    "owi535", seed=5, frames=3, width=64, height=48, layers=("normal", "coordinates", "tracks"))
PLAIN = replace(CONFIG, layers=())
EVERYTHING = {
    "images": ("rgb", "depth", "part", "flow", "flow_backward", "visibility", "normal",
               "coordinates"),
    "state": ("times", "intrinsics", "cam_from_world", "joint_positions", "world_from_part",
              "joint_screw", "joint_child_part", "part_pixels", "coordinate_box", "track_image"),
}
N = 4


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> gb.Dataset:
    out = tmp_path_factory.mktemp("stored")
    gb.render_dataset(CONFIG, N, out, 1, progress=False)
    return gb.open_dataset(out)


def assert_equal(one: dict[str, Any], two: dict[str, Any]) -> None:
    assert one.keys() == two.keys()
    for name, value in one.items():
        if isinstance(value, torch.Tensor):
            assert value.dtype == two[name].dtype
            torch.testing.assert_close(value, two[name], rtol=0, atol=0, equal_nan=True)
        else:
            assert value == two[name]


@pytest.mark.gl
@pytest.mark.parametrize("options", [
    {"pairs": True}, {"pairs": False}, {"masks": True},
    {"images": ("depth",), "state": ()},
], ids=str)
@pytest.mark.ci
def test_items_are_those_of_the_stored_dataset(
    dataset: gb.Dataset, options: dict[str, Any]
) -> None:
    from gcbench.renderer.dataset.torch import TorchDataset

    options = EVERYTHING | options
    stored = TorchDataset(dataset, **options)
    streamed = list(gb.stream(CONFIG, count=2, **options))
    assert len(streamed) == 2 * stored.items.per_sequence
    for one, two in zip(streamed, stored, strict=False):
        assert_equal(one, two)


@pytest.mark.gl
def test_a_stream_begins_anywhere_and_has_no_end() -> None:
    numbers = [item["sequence"] for item in islice(gb.stream(PLAIN, start=3), 5)]
    assert numbers == [3, 3, 4, 4, 5]


@pytest.mark.gl
@pytest.mark.ci
def test_streams_and_renders_of_a_process_do_not_disturb_each_other() -> None:
    """Each has an OpenGL context."""
    alone = [list(gb.stream(replace(PLAIN, seed=seed), count=2)) for seed in (5, 6)]
    both = zip(*(gb.stream(replace(PLAIN, seed=seed), count=2) for seed in (5, 6)), strict=True)
    for pair, *others in zip(both, *alone, strict=True):
        gb.render_sequence(PLAIN)
        for one, two in zip(pair, others, strict=True):
            assert_equal(one, two)


@pytest.mark.gl
def test_a_stream_that_stops_early_frees_its_context() -> None:
    items: Iterator[Any] = iter(gb.stream(PLAIN))
    next(items)
    from OpenGL import EGL

    assert EGL.eglGetCurrentContext()
    del items
    assert not EGL.eglGetCurrentContext()


def of(split: tuple[int, int]) -> set[int]:
    return {item["sequence"] for item in gb.stream(PLAIN, 5, 2, split, images=())}


@pytest.mark.gl
def test_ranks_share_the_sequences(monkeypatch: pytest.MonkeyPatch) -> None:
    assert [of((rank, 3)) for rank in range(3)] == [{2, 5}, {3, 6}, {4}]
    monkeypatch.setenv("RANK", "1")
    monkeypatch.setenv("WORLD_SIZE", "3")
    assert gb.stream(PLAIN).split == (1, 3)
    monkeypatch.setenv("RANK", "one")
    with pytest.raises(gb.ConfigError, match="give split="):
        gb.stream(PLAIN)


@pytest.mark.parametrize(("options", "message"), [
    ({"split": (2, 2)}, "0 to world - 1"),
    ({"count": 0}, "1 or more"),
    ({"start": -1}, "0 or more"),
    ({"images": ("normal",)}, "no image 'normal'"),
])
def test_wrong_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(gb.ConfigError, match=message):
        gb.stream(PLAIN, **options)


def test_a_pair_needs_two_frames() -> None:
    with pytest.raises(gb.ConfigError, match="pairs=False"):
        gb.stream(replace(PLAIN, frames=1))


@pytest.mark.filterwarnings("ignore:This process")  # Python 3.12: threads and fork
def test_a_forked_process_does_not_render() -> None:
    loader = torch.utils.data.DataLoader(
        gb.stream(PLAIN), num_workers=1, multiprocessing_context="fork")
    with pytest.raises(gb.ConfigError, match='multiprocessing_context="spawn"'):
        next(iter(loader))


@pytest.mark.slow
@pytest.mark.gl
def test_spawned_workers_share_the_sequences(dataset: gb.Dataset, tmp_path: Path) -> None:
    from gcbench.renderer.dataset.torch import TorchDataset

    loader = torch.utils.data.DataLoader(
        gb.stream(PLAIN, N), batch_size=2, num_workers=2, multiprocessing_context="spawn",
        persistent_workers=True)
    stored = TorchDataset(dataset)
    for _ in range(2):
        batches = list(loader)
        assert [batch["sequence"].tolist() for batch in batches] == [[0, 0], [1, 1], [2, 2], [3, 3]]
        for batch in batches:
            for k, (number, frame) in enumerate(zip(batch["sequence"], batch["frame"],
                                                    strict=True)):
                item = stored[2 * int(number) + int(frame)]
                torch.testing.assert_close(batch["flow"][k], item["flow"], rtol=0, atol=0,
                                           equal_nan=True)
                assert torch.equal(batch["rgb"][k], item["rgb"])


TRAINING = """
import gcbench as gb, os, torch
if __name__ == "__main__":
    stream = gb.stream(gb.RenderConfig("owi535", frames=3, width=64, height=48))
    loader = torch.utils.data.DataLoader(stream, num_workers=2, multiprocessing_context="spawn")
    for k, batch in enumerate(loader):
        if k == 2:
            print(open(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read(), flush=True)
"""


@pytest.mark.slow
@pytest.mark.gl
def test_no_worker_outlives_a_killed_training(tmp_path: Path) -> None:
    program = tmp_path / "training.py"
    program.write_text(TRAINING)
    training = subprocess.Popen(
        [sys.executable, str(program)], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert training.stdout
    children = [Path(f"/proc/{pid}") for pid in training.stdout.readline().split()]
    assert len(children) >= 2 and all(child.exists() for child in children)
    os.kill(training.pid, signal.SIGKILL)
    training.wait()
    training.stdout.close()
    end = time.monotonic() + 30
    while any(child.exists() for child in children) and time.monotonic() < end:
        time.sleep(0.1)
    assert not any(child.exists() for child in children)
    assert list(tmp_path.iterdir()) == [program]
