"""Whether motion can be seen: the protocol's rule, in closed form and against rays of others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gcbench import open_dataset
from gcbench.renderer.scene.config import STUDIO, RenderConfig
from gcbench.renderer.truth.observability import JointVisibility, own_motion
from gcbench.renderer.types.camera import Camera, intrinsics_from_fov

WIDTH, HEIGHT, FAR = 64, 48, 2.0
CLEAR = JointVisibility(np.radians(30.0), 5000, 0.9, 2.0)

# A plate that turns and a bar that slides on it, between fixed walls that hide some of both from
# wherever one looks.
URDF = """<robot name="stall">
  <link name="stall">
    <visual><geometry><box size="0.6 0.6 0.04"/></geometry></visual>
    <visual><origin xyz="0.28 0 0.15"/><geometry><box size="0.02 0.25 0.3"/></geometry></visual>
    <visual><origin xyz="-0.28 0 0.15"/><geometry><box size="0.02 0.25 0.3"/></geometry></visual>
    <visual><origin xyz="0 0.28 0.15"/><geometry><box size="0.25 0.02 0.3"/></geometry></visual>
    <visual><origin xyz="0 -0.28 0.15"/><geometry><box size="0.25 0.02 0.3"/></geometry></visual>
  </link>
  <joint name="turn" type="continuous"><parent link="stall"/><child link="plate"/>
    <origin xyz="0 0 0.03"/><axis xyz="0 0 1"/></joint>
  <link name="plate"><visual><origin xyz="0 0 0.15"/><geometry><box size="0.3 0.06 0.3"/></geometry>
  </visual></link>
  <joint name="rise" type="prismatic"><parent link="plate"/><child link="bar"/>
    <origin xyz="0.1 0 0.2"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>
  <link name="bar"><visual><geometry><box size="0.08 0.12 0.4"/></geometry></visual></link>
</robot>"""


# -- the rule ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seen", "prismatic", "reason"),
    [
        (CLEAR, False, ""),
        (JointVisibility(np.radians(10.0), 400, 0.25, 0.3), False, ""),
        (JointVisibility(-0.03, 400, 0.25, 0.3), True, ""),
        (replace(CLEAR, displacement=np.radians(-9.99)), False, "displacement"),
        (replace(CLEAR, displacement=0.0299), True, "displacement"),
        (replace(CLEAR, pixels=399), False, "hidden"),
        (replace(CLEAR, share=0.249), False, "occluded"),
        (replace(CLEAR, motion=0.299), False, "still"),
    ],
)
def test_each_rule_has_its_bound(seen: JointVisibility, prismatic: bool, reason: str) -> None:
    assert seen.reason(prismatic, 640, 480) == reason


def test_pixels_scale_with_the_area_and_motion_with_the_smaller_ratio() -> None:
    assert not replace(CLEAR, pixels=200).reason(False, 640, 240)
    assert replace(CLEAR, pixels=199).reason(False, 640, 240) == "hidden"
    assert not replace(CLEAR, motion=0.15).reason(False, 640, 240)
    assert replace(CLEAR, motion=0.149).reason(False, 640, 240) == "still"


# -- a joint's own motion ---------------------------------------------------------------------


def shown(screw: list[float], prismatic: bool, step: float, pixels: np.ndarray) -> float:
    """Own motion of part 2 at the given (u, v), with part 1 everywhere else, on a plane."""
    camera = Camera(WIDTH, HEIGHT, intrinsics_from_fov(WIDTH, HEIGHT, 1.0), np.eye(4))
    number = np.ones((HEIGHT, WIDTH), np.uint16)
    number[pixels[:, 1], pixels[:, 0]] = 2
    depth = np.full((HEIGHT, WIDTH), FAR, np.float32)
    index = np.flatnonzero(number == 2)
    return own_motion(camera, depth, index, np.array(screw), prismatic, step)


def test_a_slide_across_shifts_every_pixel_by_as_much() -> None:
    pixels = np.argwhere(np.ones((10, 7), bool)) + 5
    focal = intrinsics_from_fov(WIDTH, HEIGHT, 1.0)[0, 0]
    found = shown([0.6, 0.8, 0, 0, 0, 0], True, -0.05, pixels)
    assert found == pytest.approx(focal * 0.05 / FAR, rel=1e-5)


def test_a_turn_about_the_line_of_sight_moves_pixels_along_a_chord() -> None:
    k = intrinsics_from_fov(WIDTH, HEIGHT, 1.0)
    pixels = np.array([[10, 12], [40, 30], [50, 9]])
    chords = 2 * np.sin(0.15) * np.linalg.norm(pixels - k[:2, 2], axis=1)
    found = shown([0, 0, 1, 0, 0, 0], False, 0.3, pixels)
    assert found == pytest.approx(float(np.median(chords)), rel=1e-5)


def test_what_does_not_show_has_no_motion() -> None:
    assert shown([0, 0, 1, 0, 0, 0], False, 0.3, np.zeros((0, 2), np.int64)) == 0.0


# -- of a render ------------------------------------------------------------------------------


@pytest.mark.gl
def test_what_a_render_says_is_what_rays_see(tmp_path: Path) -> None:
    pytest.importorskip("embreex", reason="the second opinion casts rays with Embree")
    from gcbench.renderer.generate.driver import render_dataset

    from ...support.independent import load_robot, visibility

    urdf = tmp_path / "stall.urdf"
    urdf.write_text(URDF)
    config = RenderConfig(robot=str(urdf), seed=1, twin_of="", frames=4, width=160, height=120,
                          randomization=STUDIO, keep_unobservable=True)
    render_dataset(config, 4, tmp_path / "data", workers=1, progress=False)
    robot, shares = load_robot(urdf), list[float]()
    for sequence in open_dataset(tmp_path / "data"):
        said = sequence.meta.observability["joints"]
        seen = visibility(tmp_path / f"data/sequences/{sequence.meta.index:06d}.zip", robot)
        assert set(said) == set(seen) == {"turn", "rise"}
        for name, (displacement, pixels, share, motion) in seen.items():
            assert said[name]["displacement"] == pytest.approx(displacement, abs=1e-9)
            assert said[name]["pixels"] == pytest.approx(pixels, abs=3)
            assert said[name]["share"] == pytest.approx(share, abs=0.01)
            assert said[name]["motion"] == pytest.approx(motion, rel=0.02)
            shares.append(share)
    assert len(shares) == 8 and min(shares) < 0.8  # the walls do hide something
