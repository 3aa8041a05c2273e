"""Flow and visibility against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from gcbench.renderer.truth.correspondence import pose_table, surface_points, visibility
from gcbench.renderer.types.sequence import BACKGROUND, OCCLUDED, OUT_OF_IMAGE, VISIBLE
from gcbench.robots.geometry import revolute_motion, transform

WIDTH, HEIGHT = 40, 30
K = np.array([[50.0, 0.5, 19.0], [0.0, 60.0, 14.0], [0.0, 0.0, 1.0]])
UNIT = 1e-4
NOW = np.stack([np.eye(4), np.eye(4), np.eye(4)])  # of the world and two parts


def plane(z: float = 2.0, part: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Depth and parts of a wall at z before the camera."""
    return np.full((HEIGHT, WIDTH), z, np.float32), np.full((HEIGHT, WIDTH), part, np.uint16)


def flow(depth, part, motion) -> np.ndarray:
    """[H W 2] px where parts move by `motion` [3 4 4] in the camera frame."""
    points = surface_points(depth, part, K, 2)
    return points.flow_image(points.motion(NOW, motion))


@pytest.mark.parametrize(("shift", "expected"), [
    ((0.1, 0, 0), (50 * 0.1 / 2, 0)),  # to the right: +u, in px
    ((0, 0.1, 0), (0.5 * 0.1 / 2, 60 * 0.1 / 2)),  # down: +v (and the skew's share of u)
])
def test_translation_across_the_view_is_a_constant(shift, expected) -> None:
    motion = NOW.copy()
    motion[1] = transform(None, shift)
    np.testing.assert_allclose(
        flow(*plane(), motion), np.broadcast_to(expected, (HEIGHT, WIDTH, 2)), atol=1e-5)


def test_translation_along_the_view_grows_from_the_principal_point() -> None:
    motion = NOW.copy()
    motion[1] = transform(None, (0, 0, -1.0))  # half as far: twice as large
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    expected = np.stack([u - K[0, 2], v - K[1, 2]], -1)
    np.testing.assert_allclose(flow(*plane(), motion), expected, atol=1e-5)


def test_rotation_about_the_optical_axis_turns_x_to_y() -> None:
    motion, k = NOW.copy(), np.array([[50.0, 0, 19], [0, 50, 14], [0, 0, 1]])
    motion[1] = revolute_motion([0, 0, 1, 0, 0, 0], np.pi / 2)
    depth, part = plane()
    points = surface_points(depth, part, k, 2)
    actual = points.flow_image(points.motion(NOW, motion))
    v, u = np.mgrid[:HEIGHT, :WIDTH] - np.array([14.0, 19.0])[:, None, None]
    np.testing.assert_allclose(actual, np.stack([-v - u, u - v], -1), atol=1e-4)


def test_what_stands_still_has_exactly_zero_flow() -> None:
    here = np.stack([np.eye(4), revolute_motion([0.6, 0.8, 0, 0.1, 0.2, 0.3], 0.7), np.eye(4)])
    depth, part = plane()
    part[:, 20:] = 2
    there = here.copy()
    there[2] = transform(None, (0.1, 0, 0))
    points = surface_points(depth, part, K, 2)
    actual = points.flow_image(points.motion(here, there))
    assert (actual[:, :20] == 0).all()
    assert (actual[:, 20:, 0] != 0).all()


def test_no_surface_is_nan_and_a_still_room_is_zero() -> None:
    depth, part = plane()
    depth[:5], part[:10] = 0, 0  # nothing, then a room without a part, then the part
    motion = NOW.copy()
    motion[1] = transform(None, (0.1, 0, 0))
    actual = flow(depth, part, motion)
    assert np.isnan(actual[:5]).all()
    assert (actual[5:10] == 0).all()
    assert (actual[10:, :, 0] > 0).all()


def test_what_passes_behind_the_camera_is_nan() -> None:
    motion = NOW.copy()
    motion[1] = transform(None, (0, 0, -3.0))
    assert np.isnan(flow(*plane(), motion)).all()


def test_pose_table_holds_the_world_first() -> None:
    camera = transform(None, [[0, 0, 1.0], [0, 0, 2.0]])
    parts = np.stack([transform(None, [[1.0, 0, 0], [2.0, 0, 0]])] * 2)
    table = pose_table(camera, parts)
    assert table.shape == (2, 3, 4, 4)
    np.testing.assert_allclose(table[1, :, :3, 3], [[0, 0, 2], [1, 0, 2], [2, 0, 2]])


def test_part_pixels_are_counted() -> None:
    depth, part = plane()
    part[:3], part[10:, 5:] = 0, 2
    points = surface_points(depth, part, K, 2)
    assert points.part_pixels.tolist() == [(part == 1).sum(), (part == 2).sum()]


def test_a_wall_that_slides_under_another_is_occluded_and_leaves_the_image() -> None:
    # Part 1 fills the rows from 10 on and slides 4 px to the right, below part 2, which stands
    # nearer at columns 20-23; columns 36 on leave the image.
    depth, part = plane()
    part[:10], depth[:10] = 0, 0
    part[10:, 20:24], depth[10:, 20:24] = 2, 1.0
    motion = NOW.copy()
    motion[1] = transform(None, (4 * 2 / 50, 0, 0))
    points = surface_points(depth, part, K, 2)
    seen = visibility(points, points.motion(NOW, motion), depth, part, UNIT)
    assert (seen[:10] == BACKGROUND).all()
    assert (seen[10:, :15] == VISIBLE).all()
    # Column 16 lands on 20 and 19 on 23, whose own part is hidden there; 15 and 19 touch an edge.
    assert (seen[10:, 16:19] == OCCLUDED).all()
    assert (seen[10:, 20:24] == VISIBLE).all()  # part 2 stands still
    assert (seen[10:, 24:35] == VISIBLE).all()
    assert (seen[10:, 36:] == OUT_OF_IMAGE).all()


def test_the_same_part_at_another_depth_hides_too() -> None:
    depth, part = plane()
    points = surface_points(depth, part, K, 2)
    moved = points.motion(NOW, NOW)
    nearer = (depth * np.float32(0.99), part)
    assert (visibility(points, moved, *nearer, UNIT) == OCCLUDED).all()
    within = (depth * np.float32(0.999), part)
    assert (visibility(points, moved, *within, UNIT) == VISIBLE).all()
