"""CRAVES: crops and heat maps agree with the keypoints, angles follow from them, runs continue."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.__main__ import main
from gcbench.benchmark.methods.registry import load_method, with_options
from gcbench.gcpose.training.config import CravesTraining
from gcbench.renderer.types.camera import look_at
from gcbench.renderer.types.observation import Observation
from gcbench.robots.catalog import load_robot
from gcbench.robots.geometry import apply, inverse, pinhole, se3, transform
from gcbench.robots.model import forward_kinematics, joint_screws

from ...support import analytic, bench_data
from ...support.one_joint import dataset

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from gcbench.gcpose.learned import craves  # noqa: E402
from gcbench.gcpose.learned.arm_fit import ArmFit, _Problem  # noqa: E402
from gcbench.gcpose.networks.hourglass import StackedHourglass  # noqa: E402
from gcbench.gcpose.networks.keypoint_crops import (  # noqa: E402
    cut_crop,
    draw_maps,
    find_peaks,
    frame_keypoints,
    keypoint_errors,
    place_crop,
    to_crop,
    to_image,
)
from gcbench.gcpose.networks.weights import read_tensors, write_weights  # noqa: E402
from gcbench.gcpose.training import loop  # noqa: E402
from gcbench.gcpose.training.craves_task import CravesTask  # noqa: E402
from gcbench.gcpose.training.keypoint_images import KeypointImages  # noqa: E402

INTRINSICS = np.array([[500.0, 0, 159.5], [0, 500.0, 119.5], [0, 0, 1]])


def keypoint_data(folder: Path) -> Path:
    """Two sequences of the stream "train" whose images have 17 keypoints."""
    dataset(folder, 2)
    rng = np.random.default_rng(0)
    base = analytic.render(width=48, height=36, frames=4, room=False)
    state = dataclasses.replace(
        base.state, keypoint_part=np.ones(17, np.int64), keypoint_world=rng.random((4, 17, 3)),
        keypoint_image=rng.uniform(5, 30, (4, 17, 2)), keypoint_visible=np.ones((4, 17), bool))
    meta = dataclasses.replace(base.meta, layers=("keypoints",),
                               keypoint_names=tuple(f"k{i}" for i in range(17)))
    for index in range(2):
        (folder / f"sequences/{index:06d}.zip").unlink()
        bench_data.save(dataclasses.replace(base, state=state, meta=meta), folder, index, 1, True)
    return folder


def options(data: Path, out: Path, steps: int) -> CravesTraining:
    return CravesTraining(data=(data,), out=out, held_out=(data,), steps=steps, batch=2, width=16,
                          device="cpu", threads=1, minutes=0.0)


# -- crops and heat maps ----------------------------------------------------------------------


def test_peaks_of_the_maps_are_the_positions() -> None:
    positions = np.random.default_rng(0).uniform(10, 245, (17, 2))
    maps = draw_maps(positions)
    found, score = find_peaks(maps)
    assert np.allclose(found, positions, atol=1e-4) and (score > 0.7).all()
    outside = np.array([[-3.0, 5.0], [np.nan, np.nan], [400.0, 10.0]])
    assert not draw_maps(outside).any()
    corner = np.zeros((1, 64, 64), np.float32)
    corner[0, 63, 0] = 1
    assert np.allclose(find_peaks(corner)[0], [[1.5, 253.5]])  # the center of the cell


def test_a_crop_shows_what_the_positions_say() -> None:
    image = np.zeros((240, 320, 3), np.uint8)
    spot = np.array([200.0, 90.0])
    image[88:93, 198:203] = 255
    for side, turn in ((80.0, 0.3), (400.0, 0.0), (250.0, -0.2)):
        image_from_crop = place_crop(spot + np.array([8.0, -5.0]), side, turn)
        crop = cut_crop(image, image_from_crop)[..., 0].astype(np.float64)
        there = to_crop(image_from_crop, spot)
        grid = pinhole.pixel_grid(256, 256)
        mean = (grid * crop[..., None]).sum((0, 1)) / crop.sum()
        assert np.allclose(mean, there, atol=0.1)
        assert np.allclose(to_image(image_from_crop, there), spot)
    center, side = frame_keypoints(np.array([[10.0, 20.0], [50.0, 40.0], [np.nan, np.nan]]))
    assert np.allclose(center, [30, 30]) and side == 60


def test_a_keypoint_is_found_within_a_fifth_of_the_box_at_any_scale() -> None:
    true = np.array([[10.0, 20.0], [110.0, 20.0], [60.0, 60.0], [np.nan, np.nan]])
    found = true + np.array([[0.0, 19.9], [-20.1, 0.0], [12.0, 16.0], [0.0, 0.0]])
    found[3] = 0
    for scale in (1.0, 7.3):
        error, close = keypoint_errors(scale * found, scale * true)
        assert np.allclose(error[:3], scale * np.array([19.9, 20.1, 20.0])) and np.isnan(error[3])
        assert close[0] and not close[1] and not close[3]
    assert not keypoint_errors(found, np.full((4, 2), np.nan))[1].any()


def test_samples_repeat_and_their_maps_follow_the_crop(tmp_path: Path) -> None:
    data = keypoint_data(tmp_path / "d")
    still = dataclasses.replace(options(data, tmp_path, 1), scale=(1.0, 1.0), rotation=0.0,
                                color=(1.0, 1.0))
    images, plain = (KeypointImages([data], c) for c in (options(data, tmp_path, 1), still))
    assert len(images) == 8
    a, b = images.sample(3), images.sample(3)
    assert np.array_equal(a.image, b.image) and np.array_equal(a.maps, b.maps)
    assert a.image.shape == (3, 256, 256) and a.image.min() >= 0 and a.image.max() <= 1
    assert not np.array_equal(a.maps, images.sample(11).maps)  # another epoch
    found, _ = find_peaks(plain.sample(0).maps)
    shape = found - found[0]  # without turn and scale: the keypoints, enlarged
    drawn = [images.image(i)[1] for i in range(8)]
    sides = [frame_keypoints(p)[1] for p in drawn]
    assert min(np.abs(shape * s / 256 - (p - p[0])).max()
               for p, s in zip(drawn, sides, strict=True)) < 0.01
    with pytest.raises(GcbenchError, match="--robot owi535 --layers keypoints"):
        KeypointImages([dataset(tmp_path / "none", 1)], still).sample(0)


def test_the_network_has_the_size_of_the_paper() -> None:
    with torch.device("meta"):
        network = StackedHourglass()
    assert sum(p.numel() for p in network.parameters()) / 1e6 == pytest.approx(6.73, abs=0.005)
    with torch.no_grad():
        maps = StackedHourglass(16).eval()(torch.zeros(1, 3, 64, 128))
    assert [m.shape for m in maps] == [(1, 17, 16, 32)] * 2


# -- angles -----------------------------------------------------------------------------------


def pictured(seed: int, fit: ArmFit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles [4], cam_from_world and keypoints [17 2] px of the arm in an image."""
    rng = np.random.default_rng(seed)
    angles = np.radians(rng.uniform([-120, -60, -40, -40], [120, 40, 70, 40]))
    around, up = rng.uniform(-3, 3), rng.uniform(0.3, 0.8)
    eye = [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)]
    camera = inverse(look_at(0.8 * np.array(eye), [0, 0, 0.1]))
    pixels = pinhole.project(INTRINSICS, apply(camera, fit.points(angles)))[:, :2]
    return angles, camera, pixels


def test_the_fit_returns_the_angles_of_exact_keypoints() -> None:
    fit = ArmFit(load_robot("owi535"))
    errors: list[float] = []
    for seed in range(2):
        angles, camera, pixels = pictured(seed, fit)
        weight = np.ones(17)
        weight[[seed, 5 + seed]] = 0
        found = fit.solve(np.where(weight[:, None] > 0, pixels, 1e4), weight, INTRINSICS)
        errors += [float(np.abs(found.angles - angles).max()),
                   float(np.abs(found.cam_from_world - camera).max())]
    assert max(errors) < 1e-5
    angles, _, pixels = pictured(3, fit)
    found = fit.solve(pixels, np.ones(17), INTRINSICS)
    again = fit.solve(pixels, np.ones(17), INTRINSICS, found)  # from the pose before
    assert np.allclose(again.angles, angles) and again.residual < 1e-6
    pixels[2] += 60  # one keypoint at a wrong place
    far = fit.solve(pixels, np.ones(17), INTRINSICS, found)
    assert np.degrees(np.abs(far.angles - angles)).max() < 3


def test_a_camera_that_rolls_changes_the_angles_little() -> None:
    fit = ArmFit(load_robot("owi535"))
    angles, camera, _ = pictured(0, fit)
    roll = transform(se3.so3_exp(np.array([0.0, 0.0, 0.3])), np.zeros(3))
    pixels = pinhole.project(INTRINSICS, apply(roll @ camera, fit.points(angles)))[:, :2]
    found = fit.solve(pixels, np.ones(17), INTRINSICS)
    assert np.degrees(np.abs(found.angles - angles)).max() < 2


def test_derivatives_of_the_fit_are_differences() -> None:
    fit = ArmFit(load_robot("owi535"))
    angles, _, pixels = pictured(1, fit)
    problem = _Problem(fit, pixels, np.linspace(0.2, 1, 17), INTRINSICS, 3.0, np.arange(17))
    # the elbow is beyond its limit
    moved = angles + np.array([0.1, 0.0, 2.0, -0.1])
    x = np.concatenate([[1.9, 0.2, -0.4, 0.05, 0.02, 0.7], moved])
    steps = 1e-6 * np.eye(10)
    numeric = [(problem.residuals(x + h) - problem.residuals(x - h)) / 2e-6 for h in steps]
    assert np.allclose(problem.jacobian(x), np.transpose(numeric), rtol=1e-5, atol=1e-4)


def test_perfect_maps_give_the_displacement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The method, with maps of the true keypoints in place of those of its network."""
    model = load_robot("owi535")
    fit = ArmFit(model)
    angles, camera, _ = pictured(3, fit)
    motion = angles + np.linspace(0, 0.3, 4)[:, None] * [1, -1, 1, 1]
    pixels = [pinhole.project(INTRINSICS, apply(camera, fit.points(q)))[:, :2] for q in motion]
    write_weights(tmp_path / "w.safetensors", StackedHourglass(16), {"objects": "owi535"})
    method: Any = load_method(with_options("craves", {"weights": str(tmp_path / "w.safetensors")}))
    assert method.name.startswith("craves owi535 width=16 net=")

    def look(image: np.ndarray, center: np.ndarray, side: float) -> craves.Look:
        crop = place_crop(center, side)
        position, score = find_peaks(draw_maps(to_crop(crop, pixels[image[0, 0, 0]])))
        return craves.Look(to_image(crop, position), score, side / 64)

    monkeypatch.setattr(method, "_look", look)
    rgb = np.zeros((4, 240, 320, 3), np.uint8)
    rgb[:, 0, 0, 0] = range(4)
    seen = Observation(rgb, None, INTRINSICS, np.arange(4.0), 4, ("revolute",) * 4, model=model)
    estimate = method.estimate(seen)
    assert np.abs(estimate.displacement - (motion - motion[0])).max() < 1e-3
    q = np.append(angles, 0.0)
    true = joint_screws(model, camera @ forward_kinematics(model, q))[:4]
    assert np.abs(estimate.screw - true).max() < 1e-2
    with pytest.raises(GcbenchError, match="estimates 4 joints; this video has 2"):
        method.estimate(dataclasses.replace(seen, n_joints=2))
    with pytest.raises(GcbenchError, match="--knowledge model"):
        method.estimate(dataclasses.replace(seen, model=None))
    with pytest.raises(GcbenchError, match="keypoints of the OWI-535"):
        method.estimate(dataclasses.replace(seen, model=analytic.arm()))


def test_at_least_twelve_keypoints_take_part() -> None:
    score = np.linspace(0.0, 0.5, 17)
    assert craves.choose_keypoints(score).sum() == 12
    assert craves.choose_keypoints(score + 0.12).sum() == 16


def test_each_keypoint_is_where_the_crop_with_its_highest_score_shows_it() -> None:
    best = [np.where(np.arange(17) % 3 == k, 0.9, 0.3) for k in range(3)]
    far = [craves.Look(np.full((17, 2), 50.0 * k), best[k], 5.0) for k in range(3)]
    pixels, score = craves.merge_looks(far)
    assert np.array_equal(pixels, np.repeat(50.0 * (np.arange(17)[:, None] % 3), 2, axis=1))
    assert (score == 0.9).all()
    near = [dataclasses.replace(look, pixels=look.pixels / 10) for look in far]
    pixels, _ = craves.merge_looks(near)  # two crops at most agree within 4 cells of 5 px
    assert pixels[0] == pytest.approx([(0.3 * 5 + 0.3 * 10) / 1.5] * 2)


# -- runs -------------------------------------------------------------------------------------


def test_a_run_in_two_parts_is_the_same_to_the_bit(tmp_path: Path) -> None:
    data = keypoint_data(tmp_path / "d")
    loop.train(CravesTask(options(data, tmp_path / "whole", 4)))
    part = CravesTask(options(data, tmp_path / "parts", 4))
    count = iter(range(2))

    class Stopped(BaseException):
        """The end of the process."""

    def rate(progress: float) -> float:
        if next(count, None) is None:
            raise Stopped
        return part.config.rate

    object.__setattr__(part, "rate", rate)
    with pytest.raises(Stopped):
        loop.train(part)
    loop.train(CravesTask(options(data, tmp_path / "parts", 4)))
    ends = [read_tensors(tmp_path / k / "craves.safetensors") for k in ("whole", "parts")]
    assert all(torch.equal(ends[0][key], ends[1][key]) for key in ends[0])
    last = json.loads((tmp_path / "parts/log.jsonl").read_text().splitlines()[-1])
    assert 0 <= last["craves"]["pck"] <= 100 and last["craves"]["pixels"] > 0


def test_the_recipe_and_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    task = CravesTask(CravesTraining())
    plan = list(task.plan_data())
    assert [(p.sequences, p.held_out) for p in plan] == [(5000, False), (100, True)]
    assert len({p.config.seed for p in plan}) == 2
    assert {(p.config.robot, p.config.stream, p.config.layers) for p in plan} == {
        ("owi535", "train", ("keypoints",))}
    assert np.allclose([task.rate(x) for x in (0, 0.6, 0.7, 1)], [2.5e-4, 2.5e-4, 2.5e-5, 2.5e-5])
    assert task.count_steps(range(5000)) == 25_000  # type: ignore[arg-type]
    for wrong, said in (("--width 24", "multiple of 16"), ("--images 0", "of 1 or more"),
                        ("--scale 2 1", "smaller number first")):
        assert main(["train", "craves", *wrong.split()]) == 2
        assert said in capsys.readouterr().err
