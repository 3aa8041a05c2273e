"""A camera that adapts to the light: all frames get one exposure, and what moves stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.gcpose.images.exposure import equalize_exposure, tone_curve
from gcbench.gcpose.images.foreground import find_foreground
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.method import GCPose

from ...support.moving_panel import Video, moving_panel, overlap, with_codec, with_noise
from ...support.ray_scenes import door

SETTINGS = ImageSettings()
AS_IT_IS = replace(SETTINGS, min_exposure_change=255.0)
TIME = np.linspace(-1, 1, 12)
GAINS = {
    "exposure": np.repeat(2.0 ** (0.25 * TIME[:, None]), 3, axis=1),
    "white balance": 2.0 ** (0.15 * TIME[:, None] * [1.0, 0.0, -1.0]),
    "flicker": np.repeat(1 + 0.1 * np.sin(5.0 * np.arange(12))[:, None], 3, axis=1),
}


def exposed(rgb: Video, kind: str, bend: float = 0.0) -> Video:
    """Return images of a camera that adapts, and whose tones are an S in part."""
    light = np.clip(rgb / 255 * GAINS[kind][:, None, None], 0, 1)
    tone = (1 - bend) * light + bend * (3 * light**2 - 2 * light**3)
    return np.rint(255 * tone).astype(np.uint8)


@pytest.mark.parametrize("source", ["exact", "noise", "codec", "shadow"])
def test_a_video_of_constant_exposure_stays_as_it_is(source: str) -> None:
    rgb, _ = moving_panel()
    if source == "noise":
        rgb = with_noise(rgb, 2)
    elif source == "codec":
        rgb = with_codec(rgb)
    elif source == "shadow":
        rgb[6:, :, :100] //= 2
    assert equalize_exposure(rgb, SETTINGS) is rgb


@pytest.mark.parametrize("kind", GAINS)
@pytest.mark.parametrize("bend", [0.0, 0.5])
@pytest.mark.ci
def test_what_is_still_gets_the_same_tones(kind: str, bend: float) -> None:
    rgb, true = moving_panel()
    seen = exposed(rgb, kind, bend)
    found = equalize_exposure(seen, SETTINGS)
    still = ~true.any(axis=0)
    before, after = (np.ptp(v[:, still].astype(int), axis=0) for v in (seen, found))
    assert np.median(before) > 10
    assert np.quantile(after, 0.95) <= 4
    assert overlap(find_foreground("network", AS_IT_IS)(seen), true) < 0.5
    assert overlap(find_foreground("network", SETTINGS)(found), true) > 0.85


def test_noise_and_exposure_together_leave_the_foreground() -> None:
    rgb, true = moving_panel()
    seen = with_noise(exposed(rgb, "exposure"), 2)
    found = equalize_exposure(seen, SETTINGS)
    assert overlap(find_foreground("network", SETTINGS)(found), true) > 0.8


def test_white_that_some_frames_cut_off_does_not_change() -> None:
    rgb, true = moving_panel()
    rgb[:, 120:] = rgb[:, 120:] // 8 + 215
    rgb[:, 180:] //= 20
    found = equalize_exposure(exposed(rgb, "exposure"), SETTINGS)
    still = ~true.any(axis=0)
    assert np.quantile(np.ptp(found[:, still].astype(int), axis=0), 0.99) <= 3


def test_a_moving_object_of_one_color_does_not_bend_the_curve() -> None:
    rng = np.random.default_rng(5)
    levels = rng.uniform(10, 240, 20_000).astype(np.float32)
    usual = levels / np.float32(1.25)
    levels[:2500], usual[:2500] = rng.normal(50, 3, 2500), rng.normal(62, 3, 2500)
    tone = tone_curve(levels, usual, SETTINGS)
    assert tone[10:240] == pytest.approx(np.arange(10, 240) / 1.25, abs=1.0)
    assert (np.diff(tone) >= 0).all()


def test_frames_that_show_nothing_are_left_alone() -> None:
    rgb, _ = moving_panel()
    seen = exposed(rgb, "exposure")
    seen[[3, 5]] = 0
    seen[3, :20, :20] = 120
    found = equalize_exposure(seen, SETTINGS)
    assert found[3, 20:].max() < 20
    assert 120 <= found[3, :20, :20].min() == found[3, :20, :20].max() < 150
    assert (equalize_exposure(np.zeros_like(rgb), SETTINGS) == 0).all()
    assert np.ptp(found[[0, 11], 200:].astype(int), axis=0).max() <= 3


def test_two_frames_are_enough() -> None:
    rgb, true = moving_panel()
    found = equalize_exposure(exposed(rgb, "exposure")[[0, 11]], SETTINGS)
    still = ~true.any(axis=0)
    assert np.quantile(np.ptp(found[:, still].astype(int), axis=0), 0.95) <= 3


@pytest.mark.ci
def test_a_door_opens_under_a_camera_that_adapts() -> None:
    observation = door(0.5)
    assert observation.rgb is not None
    gain = 2.0 ** np.linspace(-0.2, 0.2, len(observation.rgb))[:, None, None, None]
    seen = replace(observation,
                   rgb=np.clip(np.rint(observation.rgb * gain), 0, 255).astype(np.uint8))
    true = 0.5 * np.linspace(0, 1, len(gain))
    found = GCPose("dis").estimate(seen).displacement[:, 0]
    assert np.degrees(np.abs(found - true).max()) < 2.0
