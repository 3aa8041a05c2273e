"""People: drawn over videos, learned from, found, and left out of the foreground."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from gcbench import RenderConfig, render_dataset
from gcbench.__main__ import main
from gcbench.gcpose.images import ImageSettings, find_foreground
from gcbench.gcpose.images.foreground_input import FOREGROUND_CHANNELS
from gcbench.gcpose.training.config import PeopleTraining
from gcbench.renderer.dataset import open_dataset

from ...support import analytic

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from gcbench.gcpose.networks.foreground import ForegroundNet  # noqa: E402
from gcbench.gcpose.networks.weights import write_weights  # noqa: E402
from gcbench.gcpose.training import loop  # noqa: E402
from gcbench.gcpose.training.foreground_videos import true_foreground  # noqa: E402
from gcbench.gcpose.training.people_drawing import draw_person  # noqa: E402
from gcbench.gcpose.training.people_task import PeopleTask  # noqa: E402
from gcbench.gcpose.training.people_videos import PeopleVideos  # noqa: E402


def options(data: Path, out: Path, steps: int) -> PeopleTraining:
    return PeopleTraining(data=(data,), out=out, held_out=(data,), steps=steps, batch=1,
                          frames=2, device="cpu", threads=1, minutes=0.0)


def test_beside_the_person_an_image_stays_but_for_a_shadow() -> None:
    sequence = analytic.render(width=160, height=120, frames=3)
    rgb = np.full((3, 120, 160, 3), 128, np.uint8)
    sequence = dataclasses.replace(sequence, rgb=rgb)
    equal = 0
    for seed in range(10):
        images, cover = draw_person(sequence, slice(None), np.random.default_rng(seed))
        again, _ = draw_person(sequence, slice(None), np.random.default_rng(seed))
        assert np.array_equal(images, again)
        assert images.shape == rgb.shape and cover.shape == rgb.shape[:3]
        change = images.astype(int) - 128
        assert (change[cover == 0] <= 0).all()
        equal += not change[cover == 0].any()
        assert (np.abs(change[cover > 250]).max(axis=-1) > 8).mean() > 0.8
    assert 0 < equal < 10


def test_the_hand_moves_with_the_object() -> None:
    sequence = analytic.render(width=160, height=120, frames=4)
    moving = true_foreground(sequence, slice(None))
    near = 0
    for seed in range(20):
        _, cover = draw_person(sequence, slice(None), np.random.default_rng(seed))
        wide = np.stack([cv2.dilate(m.astype(np.uint8), np.ones((9, 9))) > 0 for m in moving])
        near += bool((wide & (cover > 127)).any(axis=(1, 2)).all())
    assert near >= 15


def test_samples_show_people_or_not(data: Path, tmp_path: Path) -> None:
    always = dataclasses.replace(options(data, tmp_path, 1), people_probability=1.0)
    with_person = PeopleVideos([data], always).sample(3)
    again = PeopleVideos([data], always).sample(3)
    assert np.array_equal(with_person.frames, again.frames)
    assert with_person.frames.shape[1] == FOREGROUND_CHANNELS
    assert with_person.moving.max() == 1
    never = dataclasses.replace(always, people_probability=0.0)
    assert not PeopleVideos([data], never).sample(3).moving.any()


def test_a_network_learns_and_its_errors_are_measured(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    loop.train(PeopleTask(options(data, tmp_path / "one", 2)))
    weights = tmp_path / "one/people.safetensors"
    assert find_foreground(f"no-people:{weights}", ImageSettings())
    torch.manual_seed(1)
    write_weights(weights, ForegroundNet(FOREGROUND_CHANNELS))
    command = ["train", "people", "--steps", "0", "--held-out", str(data), "--out",
               str(tmp_path / "out"), "--start-from", str(weights)]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert all(word in said for word in ("iou", "worst", "lost", "alone", "network"))
    found = json.loads((tmp_path / "out/log.jsonl").read_text().splitlines()[-1])
    assert all(0 <= found["network"][name] <= 100 for name in ("iou", "worst", "lost", "alone"))


@pytest.mark.ci
def test_the_included_weights_leave_a_person_out(tmp_path: Path) -> None:
    config = RenderConfig(robot="dishwasher", seed=6, frames=6, width=320, height=240)
    render_dataset(config, n=3, out=tmp_path / "door", workers=1)
    leave_out, keep = (find_foreground(name, ImageSettings()) for name in ("no-people", "network"))
    of_person, of_door, alone = [], [], []
    for k, sequence in enumerate(open_dataset(tmp_path / "door")):
        images, cover = draw_person(sequence, slice(None), np.random.default_rng(k))
        person, found = cover > 127, leave_out(images)
        both = keep(images)
        assert (both & person).sum() > 0.5 * person.sum()
        of_person.append((found & person).sum() / person.sum())
        of_door.append((found & ~person).sum() / (both & ~person).sum())
        rgb = np.asarray(sequence.rgb[:])
        alone.append(leave_out(rgb).sum() / keep(rgb).sum())
    assert np.mean(of_person) < 0.1
    assert np.mean(of_door) > 0.7
    assert np.mean(alone) > 0.9
