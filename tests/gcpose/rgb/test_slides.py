"""A part that slides on plain video, with the depth of what moves known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.errors import ConfigError
from gcbench.gcpose.method import GCPose

from ...support.ray_scenes import drawer

DEPTH = 1.15


@pytest.mark.parametrize(
    "knows_direction", [pytest.param(True, marks=pytest.mark.ci), False])
def test_a_slide_has_a_scale_if_its_depth_is_known(knows_direction: bool) -> None:
    seen = drawer(0.2)
    assert seen.axis_direction is not None
    axis = seen.axis_direction[0]
    if not knows_direction:
        seen = replace(seen, axis_direction=None, cam_from_world=None)
    found = GCPose().estimate(seen, DEPTH)
    assert found.screw is not None and found.sigma is not None and found.reliable is not None
    cosine = float(found.screw[0, :3] @ axis)
    assert abs(cosine) > np.cos(np.radians(3))
    moved = np.sign(cosine) * found.displacement[:, 0]
    assert moved == pytest.approx(np.linspace(0, 0.2, 8), abs=0.008)
    assert found.reliable[0] and 0 < found.sigma[-1, 0] < 0.03


@pytest.mark.ci
def test_the_depth_is_that_of_frame_0_where_a_slide_begins_slowly() -> None:
    """Images near frame 0 hardly move, so that they do not tell the depth."""
    pace = np.linspace(0, 1, 16) ** 4
    found = GCPose().estimate(drawer(0.45, pace), DEPTH)
    assert found.displacement[:, 0] == pytest.approx(0.45 * pace, abs=0.015)


@pytest.mark.ci
def test_without_its_depth_a_slide_has_no_scale() -> None:
    found = GCPose().estimate(drawer(0.2))
    assert found.reliable is not None and not found.reliable[0]


@pytest.mark.parametrize("depth", [0.0, -1.0, np.nan, np.inf])
def test_a_depth_that_is_no_length_is_an_error(depth: float) -> None:
    with pytest.raises(ConfigError, match=r"object_depth=.*: give a positive length"):
        GCPose().estimate(drawer(0.2), depth)
