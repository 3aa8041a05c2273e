"""Straight edges of a door show the focal length of the camera."""

from __future__ import annotations

from dataclasses import replace

import pytest
from gcbench.gcpose.rgb.focal_length import find_focal_length
from gcbench.gcpose.rgb.settings import RgbSettings

from .test_door_edges import TURN, K, video

SETTINGS = RgbSettings()


@pytest.mark.ci
def test_the_focal_length_of_a_door_that_turns_is_found() -> None:
    wrong = K.copy()
    wrong[[0, 1], [0, 1]] = 230.0
    found = find_focal_length(replace(video(TURN), intrinsics=wrong), SETTINGS)
    assert found == pytest.approx(K[0, 0], rel=0.1)


def test_a_door_that_hardly_turns_does_not_tell_it() -> None:
    assert find_focal_length(video(0.02 * TURN), SETTINGS) is None


def test_a_video_without_edges_does_not_tell_it() -> None:
    plain = video(TURN)
    plain.gray[:] = 90
    assert find_focal_length(plain, SETTINGS) is None
