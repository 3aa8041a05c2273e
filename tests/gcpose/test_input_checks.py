"""Observations that do not fit together are refused in one line."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gcbench import ConfigError, MethodError
from gcbench.gcpose.input_checks import check_observation
from gcbench.gcpose.method import GCPose
from gcbench.renderer.types.observation import Observation

from ..support.boxes import FRAMES, HEIGHT, INTRINSICS, WIDTH, scene


@pytest.fixture(scope="module")
def arm() -> Observation:
    return scene("arm")[0]


def line(change: float) -> np.ndarray:
    axes = scene("arm")[2].copy()
    axes[1] *= change
    return axes


SKEW = INTRINSICS + np.array([[0, 26.0, 0], [0, 0, 0], [0, 0, 0]])
IMAGES = np.zeros((FRAMES, HEIGHT, WIDTH))


@pytest.mark.parametrize(("changes", "message"), [
    ({"joint_types": ("revolute",)}, "n_joints = 2 and 1 joint_types"),
    ({"n_joints": 0, "joint_types": ()}, "at least one joint"),
    ({"joint_types": ("revolute", "ball")}, "not 'ball'"),
    ({"joint_parent": (-1, 5)}, r"an earlier joint, not \(-1, 5\)"),
    ({"joint_parent": (1, -1)}, "an earlier joint"),
    ({"axis_line": line(1)[:1]}, r"axis_line of shape \[2, 6\], not float64 \[1, 6\]"),
    ({"axis_line": line(np.nan)}, "a finite axis_line"),
    ({"axis_line": line(5)}, "axes of length 1 in axis_line, not 5"),
    ({"axis_line": None, "axis_direction": np.zeros((2, 3))}, "in axis_direction, not 0"),
    ({"intrinsics": SKEW}, "without skew, not 26 px; undistort"),
    ({"intrinsics": 0 * INTRINSICS}, "focal lengths above 0"),
    ({"cam_from_world": np.full((4, 4), np.inf)}, "a finite cam_from_world"),
    ({"times": np.arange(3.0)}, r"times of shape \[8\], not float64 \[3\]"),
    ({"depth": IMAGES[:5]}, r"depth of shape \[8, 180, 240\], not float64 \[5, "),
    ({"depth": IMAGES[:, ::2, ::2]}, r"depth of shape .* not float64 \[8, 90, 120\]"),
    ({"rgb": IMAGES}, r"rgb of shape \[8, 180, 240, 3\]"),
    ({"rgb": np.zeros((*IMAGES.shape, 3), np.uint16)}, r"rgb as uint8 \(0 to 255\), not uint16"),
    ({"rgb": np.zeros((*IMAGES.shape, 3))}, r"rgb as uint8 \(0 to 255\), not float64"),
    ({"rgb": [IMAGES[0].astype(np.uint8)] * FRAMES}, "rgb as one NumPy array, not list"),
    ({"depth": list(IMAGES)}, "depth as one NumPy array, not list; numpy.array "),
    ({"intrinsics": None}, r"needs intrinsics \[3, 3\]; they are missing"),
    ({"intrinsics": INTRINSICS.tolist()}, "intrinsics as one NumPy array, not list"),
    ({"times": None}, r"needs times \[8\]; they are missing"),
    ({"part": IMAGES.astype(np.uint8) + 3}, "parts 0 to 2, not 3"),
    ({"depth": IMAGES + 1500.0}, "in meters, not 1500 .* divide millimeters by 1000"),
    ({"depth": IMAGES.astype(np.uint16)}, r"not uint16, in meters; .*numpy.float32\) / 1000"),
    ({"mask": IMAGES.astype(np.uint8)}, "mask as booleans, not uint8; of integers: mask > 0"),
    ({"rgb": None}, "needs rgb, also with depth"),
    *[({"depth_noise": wrong}, r"depth_noise from 0 \(exact\) to 1 m, not ")
      for wrong in (-0.01, 20, np.nan, np.inf, None, "a")],
    ({"flow": IMAGES}, r"flow of shape \[7, 180, 240, 2\]"),
])  # fmt: skip
def test_what_does_not_fit_is_refused(
    arm: Observation, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(MethodError, match=message) as error:
        GCPose().estimate(replace(arm, **changes))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_depth_that_is_not_finite_is_no_surface(arm: Observation, value: float) -> None:
    assert arm.depth is not None
    hole = np.random.default_rng(0).random(arm.depth.shape) < 0.02
    zero, other = (replace(arm, depth=np.where(hole, x, arm.depth).astype(np.float32))
                   for x in (0.0, value))
    found = check_observation(other).depth
    assert found is not None and found.dtype == np.float32
    np.testing.assert_array_equal(found, zero.depth)


@pytest.mark.parametrize("wrong", [0, -1.0, np.nan, "1.4"])
def test_the_depth_of_an_object_is_a_positive_length(arm: Observation, wrong: Any) -> None:
    with pytest.raises(ConfigError, match="give a positive length, m"):
        GCPose().estimate(arm, wrong)


def test_a_motion_of_which_too_little_is_seen_is_refused(
    arm: Observation, monkeypatch: pytest.MonkeyPatch
) -> None:
    singular = np.zeros((2, 2))
    monkeypatch.setattr(GCPose, "_estimate", lambda *_: np.linalg.solve(singular, singular))
    with pytest.raises(MethodError, match=r"too little of what moves .* use larger images"):
        GCPose().estimate(arm)
