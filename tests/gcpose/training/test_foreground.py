"""Training of the foreground: true masks, samples that repeat, runs that continue, errors."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.__main__ import main
from gcbench.gcpose.images.foreground_input import FOREGROUND_CHANNELS, FOREGROUND_SIDE
from gcbench.gcpose.training.config import ForegroundTraining
from gcbench.renderer.dataset import open_dataset

from ...support import analytic, bench_data

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from gcbench.gcpose.networks.foreground import ForegroundNet  # noqa: E402
from gcbench.gcpose.networks.weights import read_tensors, write_weights  # noqa: E402
from gcbench.gcpose.training import loop  # noqa: E402
from gcbench.gcpose.training.foreground_task import ForegroundTask  # noqa: E402
from gcbench.gcpose.training.foreground_videos import ForegroundVideos, true_foreground  # noqa: E402
from gcbench.renderer.runtime import command_line  # noqa: E402


def options(data: Path, out: Path, steps: int) -> ForegroundTraining:
    return ForegroundTraining(data=(data,), out=out, held_out=(data,), steps=steps, batch=1,
                              frames=2, device="cpu", threads=1, minutes=0.0)


def test_what_stands_still_is_background() -> None:
    sequence = analytic.render(width=60, height=45, frames=3)
    part = np.asarray(sequence.part[:])
    found = true_foreground(sequence, slice(None))
    assert (found == (part >= 2)).all() and found.any() and (part == 1).any()  # 1: the base
    pose = sequence.state.world_from_part.copy()
    pose[:, 2] = pose[:1, 2]
    still = dataclasses.replace(
        sequence, state=dataclasses.replace(sequence.state, world_from_part=pose))
    assert (true_foreground(still, slice(1, 2)) == ((part != 3) & (part >= 2))[1:2]).all()


def test_samples_repeat(data: Path, tmp_path: Path) -> None:
    videos = ForegroundVideos([data], options(data, tmp_path, 1))
    a, b, other = videos.sample(5), videos.sample(5), videos.sample(7)
    assert np.array_equal(a.frames, b.frames) and np.array_equal(a.moving, b.moving)
    assert a.frames.shape == (2, FOREGROUND_CHANNELS, FOREGROUND_SIDE, FOREGROUND_SIDE)
    assert a.moving.shape == (2, FOREGROUND_SIDE, FOREGROUND_SIDE)
    assert 0 <= a.moving.min() < a.moving.max() <= 1
    assert not np.array_equal(a.frames, other.frames)
    with pytest.raises(GcbenchError, match="lower --frames 40"):
        ForegroundVideos([data], dataclasses.replace(options(data, tmp_path, 1), frames=40))


def test_the_mask_follows_the_changes_of_a_sample(data: Path, tmp_path: Path) -> None:
    """Without a background, the pixels that show a surface are those of the arm."""
    sequence = analytic.render(width=64, height=48, frames=2, room=False)
    seen = np.asarray(sequence.part[:])[..., None] > 0
    rgb = np.where(seen, 220, 20).astype(np.uint8).repeat(3, axis=-1)
    path = data / "sequences/000000.zip"
    path.unlink()
    bench_data.save(dataclasses.replace(sequence, rgb=rgb), data, 0, 1.0, True)
    (data / "sequences/000001.zip").unlink()
    dataset = open_dataset(data)
    assert len(dataset) == 1
    plain = dataclasses.replace(options(data, tmp_path, 1), noise_probability=0.0)
    videos = ForegroundVideos([data], plain)
    for number in range(4):
        sample = videos.sample(number)
        bright = sample.frames[:, :3].mean(axis=1)
        middle = (bright.max() + bright.min()) / 2
        sure = sample.moving > 0.95
        assert sure.any() and (bright[sure] > middle).mean() > 0.98


def test_a_run_continues_where_it_stopped(data: Path, tmp_path: Path) -> None:
    whole = ForegroundTask(options(data, tmp_path / "whole", 4))
    loop.train(whole)
    part = ForegroundTask(options(data, tmp_path / "part", 4))
    steps = iter(range(2))

    class Interrupted(ForegroundTask):
        def loss(self, *arguments: object) -> object:  # type: ignore[override]
            next(steps)
            return super().loss(*arguments)  # type: ignore[arg-type]

    with pytest.raises(StopIteration):
        loop.train(Interrupted(part.config))
    loop.train(part)
    a, b = (read_tensors(tmp_path / name / "foreground.safetensors") for name in ("whole", "part"))
    assert a.keys() == b.keys() and all(torch.equal(a[k], b[k]) for k in a)


def test_errors_are_measured_beside_those_without_a_network(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.manual_seed(1)
    weights = tmp_path / "random.safetensors"
    write_weights(weights, ForegroundNet(FOREGROUND_CHANNELS))
    command = ["train", "foreground", "--steps", "0", "--held-out", str(data), "--out",
               str(tmp_path / "out"), "--start-from", str(weights)]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert all(word in said for word in ("iou", "worst", "background", "network"))
    found = json.loads((tmp_path / "out/log.jsonl").read_text().splitlines()[-1])
    assert 0 <= found["network"]["worst"] <= found["network"]["iou"] <= 100


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--frames 1", "--frames 1: give a number of 2 or more"),
        ("--models 0", "--models"),
        ("--gain 1.2 0.7", "smaller number first"),
    ],
)
def test_wrong_options_are_refused(words: str, said: str) -> None:
    config = command_line.parse_options(
        words.split(), "train foreground", ForegroundTraining, "help")
    with pytest.raises(GcbenchError, match=said):
        ForegroundTask(config).check_options()


def test_data_are_planned_of_the_stream_train() -> None:
    planned = list(ForegroundTask(ForegroundTraining(models=2)).plan_data())
    assert {p.config.stream for p in planned} == {"train"}
    assert len({p.config.seed for p in planned}) == len({p.name for p in planned}) == len(planned)
    held = {p.config.robot for p in planned if p.held_out}
    assert {"dishwasher", "microwave", "oven"} < held
    assert not {p.config.robot for p in planned if p.config.robot.startswith("random:")
                and not p.held_out} & held
