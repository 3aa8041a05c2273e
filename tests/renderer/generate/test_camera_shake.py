"""A camera that is held by hand: its path, and the truth of images that it makes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gcbench.renderer.dataset import open_dataset
from gcbench.renderer.generate import render_dataset
from gcbench.renderer.scene import CameraConfig, RenderConfig, shake_camera
from gcbench.renderer.types import Camera, Sequence, intrinsics_from_fov, look_at
from gcbench.renderer.verify import verify_dataset

CAMERA = Camera(64, 48, intrinsics_from_fov(64, 48, 0.8), look_at([1.0, 2.0, 1.5], [0, 0, 0.3]))
HELD = CameraConfig(shake_turn=(0.5, 0.5), shake_shift=(0.01, 0.01))
SMALL = RenderConfig(robot="microwave", frames=4, width=160, height=120, seed=3,
                     layers=("normal", "coordinates", "tracks"))


def test_a_camera_that_is_not_shaken_draws_nothing() -> None:
    rng = np.random.default_rng(1)
    cameras = shake_camera(rng, CameraConfig(), CAMERA, 5)
    assert len(cameras) == 5
    assert all(camera is CAMERA for camera in cameras)
    assert rng.random() == np.random.default_rng(1).random()


def test_turns_and_shifts_have_the_size_that_is_asked_for() -> None:
    cameras = shake_camera(np.random.default_rng(2), HELD, CAMERA, 300)
    assert cameras[0] is CAMERA
    moved = np.stack([CAMERA.cam_from_world @ camera.world_from_cam for camera in cameras])
    shift = moved[:, :3, 3]
    assert np.sqrt((shift**2).mean()) == pytest.approx(0.01)
    turn = np.degrees(np.arccos((np.trace(moved[:, :3, :3], axis1=1, axis2=2) - 1) / 2))
    assert np.sqrt((turn**2).mean() / 3) == pytest.approx(0.5, rel=1e-6)


def test_a_single_frame_stands_still() -> None:
    (camera,) = shake_camera(np.random.default_rng(3), HELD, CAMERA, 1)
    assert camera is CAMERA


def rendered(folder: Path, camera: CameraConfig, room: float) -> Sequence:
    ranges = SMALL.randomization
    config = replace(SMALL, randomization=replace(
        ranges, camera=camera, background=replace(ranges.background, room=room)))
    render_dataset(config, 1, folder, 1, progress=False)
    return open_dataset(folder)[0]


@pytest.mark.gl
@pytest.mark.parametrize("room", [0.0, 1.0])
@pytest.mark.ci
def test_the_truth_is_that_of_the_camera_of_each_frame(tmp_path: Path, room: float) -> None:
    still = rendered(tmp_path / "still", CameraConfig(), room)
    held = rendered(tmp_path / "held", HELD, room)
    assert verify_dataset(tmp_path / "held").ok

    for name in ("rgb", "depth", "part"):
        one, other = np.asarray(getattr(still, name)[:]), np.asarray(getattr(held, name)[:])
        np.testing.assert_array_equal(one[0], other[0])
        assert (one[1:] != other[1:]).any()
    np.testing.assert_array_equal(still.state.world_from_part, held.state.world_from_part)
    assert np.ptp(held.state.cam_from_world, axis=0).max() > 1e-3

    flow, behind = np.asarray(held.stack("flow")[:]), np.asarray(held.part[:-1]) == 0
    speed = np.linalg.norm(flow[behind], axis=1)
    assert np.isnan(speed).all() if room == 0 else (speed > 0).mean() > 0.99
    assert (np.asarray(held.stack("visibility")[:])[behind] == 0).all()


@pytest.mark.gl
@pytest.mark.ci
def test_an_image_behind_a_camera_that_turns_turns_as_well(tmp_path: Path) -> None:
    turning = CameraConfig(shake_turn=(2.0, 2.0))
    still = rendered(tmp_path / "still", CameraConfig(), 0.0)
    held = rendered(tmp_path / "held", turning, 0.0)
    state = held.state
    turn = state.cam_from_world[-1, :3, :3] @ state.cam_from_world[0, :3, :3].T
    to = state.intrinsics @ turn @ np.linalg.inv(state.intrinsics)
    v, u = np.mgrid[10:110:5, 10:150:5]
    there = to @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    column, row = np.rint(there[:2] / there[2]).astype(int)
    inside = (column >= 0) & (column < 160) & (row >= 0) & (row < 120)
    u, v, column, row = u.ravel()[inside], v.ravel()[inside], column[inside], row[inside]
    seen = (still.part[0][v, u] == 0) & (held.part[-1][row, column] == 0)
    assert seen.sum() > 50
    before, after = (np.asarray(image, int) for image in (
        still.rgb[0][v, u][seen], held.rgb[-1][row, column][seen]))
    stays = np.asarray(held.rgb[-1][v, u][seen], int)
    assert np.abs(after - before).mean() < np.abs(stays - before).mean() / 2
