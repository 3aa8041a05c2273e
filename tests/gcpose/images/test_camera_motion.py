"""The motion of a camera that is held by hand goes, and that of the object stays."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from gcbench.errors import MethodError
from gcbench.gcpose.images import to_still_video
from gcbench.gcpose.images.camera_motion import CameraMotion, find_camera_motion
from gcbench.gcpose.images.foreground import find_foreground
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_scene import show_still_scene
from gcbench.gcpose.method import GCPose
from gcbench.renderer.types import Estimate, Observation

from ...support.moving_panel import (
    Video,
    before_a_near_board,
    moving_panel,
    overlap,
    with_codec,
    with_noise,
    with_shake,
)
from ...support.ray_scenes import door

SETTINGS = ImageSettings()
INTRINSICS = np.array([[320.0, 0, 160], [0, 320, 120], [0, 0, 1]])


def observation(rgb: Video) -> Observation:
    return Observation(rgb, None, INTRINSICS, np.arange(len(rgb)) / 10, 1, ("revolute",))


def test_a_camera_on_a_stand_is_still_whatever_moves_before_it() -> None:
    rgb, true = moving_panel()
    large, _ = moving_panel(height=200, width=150)
    brighter = (rgb * np.linspace(0.4, 1, 12)[:, None, None, None]).astype(np.uint8)
    for video in (rgb, with_noise(rgb, 2), with_codec(rgb), with_noise(large, 2),
                  with_noise(brighter, 2)):
        assert find_camera_motion(video, INTRINSICS, SETTINGS) is None
    seen = observation(rgb)
    still = to_still_video(seen, SETTINGS)
    assert still.observation.rgb is rgb
    estimate = Estimate(np.zeros((12, 1)), part=true.astype(np.uint8))
    assert still.move_back(estimate) is estimate


@pytest.mark.parametrize("noise", [0, 2])
def test_the_homographies_are_those_of_the_camera(noise: float) -> None:
    rgb, true = moving_panel()
    shaken, homography = with_shake(rgb)
    video = with_noise(shaken, noise) if noise else shaken
    motion = find_camera_motion(video, INTRINSICS, SETTINGS)
    assert motion is not None
    corner = np.array([[[0, 0]], [[320, 0]], [[0, 240]], [[320, 240]]], np.float64)
    apart = np.stack([cv2.perspectiveTransform(corner, a) - cv2.perspectiveTransform(corner, b)
                      for a, b in zip(motion.homography(0.0), homography, strict=True)])
    assert np.abs(apart).mean() < 0.3
    assert np.abs(apart).max() < 2  # where the panel hides the wall
    assert 5 < motion.shift < 16
    assert motion.error < 0.5
    still, _ = show_still_scene(shaken, motion, SETTINGS)
    inside = ~true.any(axis=0)
    change = np.abs(still.astype(int) - rgb)[:, inside]
    assert change.mean() < 3 < np.abs(shaken.astype(int) - rgb)[:, inside].mean()


def test_parts_return_to_the_images_as_they_were() -> None:
    rgb, true = moving_panel()
    shaken, homography = with_shake(rgb)
    there = np.stack([cv2.warpPerspective(m.astype(np.uint8), h, (320, 240))
                      for m, h in zip(true, homography, strict=True)])
    still = to_still_video(observation(shaken), SETTINGS)
    part = still.move_back(Estimate(np.zeros((12, 1)), part=true.astype(np.uint8))).part
    assert part is not None
    assert overlap(part > 0, there > 0) > 0.95 > overlap(true, there > 0)


@pytest.mark.ci
def test_an_estimate_has_parts_at_the_pixels_of_the_video() -> None:
    seen = door(0.5)
    assert seen.rgb is not None
    shaken, homography = with_shake(seen.rgb, 20.0)
    usual, moved = (GCPose().estimate(replace(seen, rgb=rgb)).part for rgb in (seen.rgb, shaken))
    assert usual is not None and moved is not None
    there = np.stack([cv2.warpPerspective(part, h, (240, 180))
                      for part, h in zip(usual, homography, strict=True)])
    assert overlap(moved > 0, there > 0) > overlap(moved > 0, usual > 0) + 0.1


def test_only_what_moves_changes_before_a_background_at_two_depths() -> None:
    rgb, true, board = before_a_near_board()
    motion = find_camera_motion(rgb, INTRINSICS, SETTINGS)
    assert motion is not None
    assert motion.error < 0.7
    assert motion.explained is not None
    still, homography = show_still_scene(rgb, motion, SETTINGS)
    corner = np.array([[[60, 50]], [[260, 50]], [[260, 190]], [[60, 190]]], np.float64)
    moved = np.stack([cv2.perspectiveTransform(corner, h) - corner for h in homography])
    assert np.abs(moved - board[:, None, None]).mean() < 0.5
    near = np.stack([cv2.dilate(t.astype(np.uint8), np.ones((15, 15))) > 0 for t in true])
    inside = np.zeros_like(near)  # the outline of the board hides and shows the wall
    inside[:, 60:180, 70:250], inside[:, 15:40, 15:305] = True, True
    changed = np.abs(still.astype(int) - still[6]).max(axis=3) > 10
    assert changed[inside & ~near & ~near[6]].mean() < 0.005
    panel = np.abs(still.astype(int) - rgb[0]).max(axis=3)[true & ~true[0]]
    assert np.median(panel) > 20


@pytest.mark.parametrize(("error", "explained", "reliable"), [
    (1.0, None, True), (1.5, None, False), (1.0, 30, True), (1.0, 10, False)])
def test_no_joint_is_reliable_if_the_motion_of_the_camera_is_not_known_well(
    error: float, explained: int | None, reliable: bool
) -> None:
    still = CameraMotion(np.eye(3)[None], np.zeros((1, 3)), np.zeros((0, 2)), np.zeros(0), 5.0,
                         error, explained)
    assert still.is_sure(SETTINGS) == reliable
    shaken, _ = with_shake(moving_panel()[0])
    video = replace(to_still_video(observation(shaken), SETTINGS), sure=reliable)
    estimate = Estimate(np.zeros((12, 1)), reliable=np.array([True]))
    assert video.move_back(estimate).reliable == reliable


def test_the_foreground_is_found_in_spite_of_a_hand() -> None:
    rgb, true = moving_panel()
    shaken = with_noise(with_shake(rgb)[0], 1)
    find = find_foreground("network", SETTINGS)
    assert overlap(find(shaken), true) < 0.5
    still = to_still_video(observation(shaken), SETTINGS).observation.rgb
    assert still is not None
    assert overlap(find(still), true) > 0.8


def test_a_camera_that_moves_too_much_is_an_error_that_names_the_fix() -> None:
    rgb, _ = moving_panel()
    far = with_shake(rgb, 100)[0]
    with pytest.raises(MethodError, match="the camera moves too much; put it on a stand"):
        find_camera_motion(far, INTRINSICS, SETTINGS)
    pieces = np.concatenate([with_shake(rgb, size)[0][:, v : v + 60] for v, size in (
        (0, 20), (60, -20), (120, 8), (180, -12))], axis=1)
    with pytest.raises(MethodError, match="the camera moves too much"):
        find_camera_motion(pieces[[0, 7, 3, 9, 5, 11, 2]], INTRINSICS, SETTINGS)


def test_images_that_come_with_truth_are_not_aligned() -> None:
    seen = observation(with_shake(moving_panel()[0])[0])
    flow, depth = np.zeros((11, 240, 320, 2), np.float32), np.ones((12, 240, 320), np.float32)
    for with_truth in (replace(seen, flow=flow), replace(seen, mask=depth > 0),
                       replace(seen, depth=depth)):
        assert to_still_video(with_truth, SETTINGS).homography is None
