"""The noise of a camera and of a codec goes, and what moves stays."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from gcbench.gcpose.images.camera_noise import remove_camera_noise, still_change
from gcbench.gcpose.images.foreground import find_foreground
from gcbench.gcpose.images.settings import ImageSettings

from ...support.moving_panel import Video, moving_panel, overlap, with_codec, with_noise

SETTINGS = ImageSettings()


def changing(rgb: Video) -> float:
    """Share of the pixels that change."""
    return float((rgb != rgb[0]).any(axis=(0, 3)).mean())


def test_a_video_without_noise_stays_as_it_is() -> None:
    rgb, _ = moving_panel()
    assert remove_camera_noise(rgb, SETTINGS) is rgb
    faint = np.full_like(rgb, 100)
    faint[6:, :, :190] += 2  # a shadow over most of the image
    assert remove_camera_noise(faint, SETTINGS) is faint


@pytest.mark.parametrize("source", ["camera", "codec"])
def test_what_is_still_does_not_change_and_what_moves_stays(source: str) -> None:
    rgb, true = moving_panel()
    noisy = with_noise(rgb, 2) if source == "camera" else with_codec(rgb)
    clean = remove_camera_noise(noisy, SETTINGS)
    assert changing(noisy) > 0.9
    assert changing(clean) < true.any(axis=0).mean() + 0.05
    kept = (clean == noisy).all(axis=3)
    median = (clean == np.sort(noisy, axis=0)[6]).all(axis=3)
    assert (kept | median).all()
    assert kept[true].mean() > 0.9


@pytest.mark.parametrize("source", ["camera", "codec"])
@pytest.mark.ci
def test_the_foreground_is_found_in_spite_of_noise(source: str) -> None:
    rgb, true = moving_panel()
    noisy = with_noise(rgb, 2) if source == "camera" else with_codec(rgb)
    keep_noise = ImageSettings(max_noise=1e-6, most_noise=1e-6)
    assert overlap(find_foreground("network", keep_noise)(noisy), true) < 0.5
    assert overlap(find_foreground("network", SETTINGS)(noisy), true) > 0.8
    assert overlap(find_foreground("background", SETTINGS)(noisy), true) > 0.8


def test_the_noise_is_that_of_still_pixels_where_most_move() -> None:
    rgb, true = moving_panel(height=200, width=150)
    assert 0.5 < true.any(axis=0).mean() < 0.8
    small, large = (
        still_change(blurred, np.sort(blurred, axis=0)[6], SETTINGS)
        for blurred in (np.stack([cv2.GaussianBlur(i, (0, 0), 1.5) for i in
                                  with_noise(rgb, deviation).astype(np.float32)])
                        for deviation in (1, 2)))
    assert 0.2 < small < large < 1.5
    clean = remove_camera_noise(with_noise(rgb, 2), SETTINGS)
    assert changing(clean) < true.any(axis=0).mean() + 0.05


def test_strong_noise_goes_as_well() -> None:
    rgb, true = moving_panel()
    noisy = with_noise(rgb, 12)  # of which more than 4 grey levels remain after the blur
    keep_noise = ImageSettings(most_noise=4.0)
    assert remove_camera_noise(noisy, keep_noise) is noisy
    clean = remove_camera_noise(noisy, SETTINGS)
    assert changing(clean) < true.any(axis=0).mean() + 0.05


def test_two_frames_are_enough() -> None:
    rgb, true = moving_panel()
    clean = remove_camera_noise(with_noise(rgb[[0, 11]], 2), SETTINGS)
    assert changing(clean) < true[[0, 11]].any(axis=0).mean() + 0.05


def test_white_that_is_cut_off_does_not_hide_the_noise() -> None:
    rgb, true = moving_panel()
    noisy = with_noise(rgb, 2)
    noisy[:, 90:] = 255
    clean = remove_camera_noise(noisy, SETTINGS)
    assert changing(noisy) > 0.3
    assert changing(clean) < true.any(axis=0).mean() + 0.05
    white = np.full((3, 40, 50, 3), 255, np.uint8)
    assert remove_camera_noise(white, SETTINGS) is white
