"""Straight edges of a door show how far it turns."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import VideoEvidence
from gcbench.gcpose.images.straight_edges import moving_edges
from gcbench.gcpose.rgb.door_edges import DoorEdges, measure_tilts, see_edges
from gcbench.gcpose.rgb.edge_planes import EdgePlanes, planes_of_moving_edges
from gcbench.gcpose.rgb.settings import RgbSettings
from gcbench.robots.geometry import se3

SETTINGS = RgbSettings()
K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
AXIS = np.array([0.1, 0.98, 0.2]) / np.linalg.norm([0.1, 0.98, 0.2])
ACROSS = np.cross(AXIS, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(AXIS, [0.0, 0.0, 1.0]))
FOOT = np.array([-0.25, 0.0, 1.5])
TURN = np.radians(np.linspace(0, -40, 12))
STILL = np.array([[20, 30], [110, 36]])
"""Ends of an edge beside the door that does not move, px."""


def pixels(share: np.ndarray, turn: float) -> np.ndarray:
    """[N 2] px of points of the door, by their shares [N 2] of its width and its height."""
    start = FOOT + share[:, :1] * 0.5 * ACROSS + (share[:, 1:] - 0.5) * 0.6 * AXIS
    at = ((start - FOOT) @ se3.so3_exp(turn * AXIS).T + FOOT) @ K.T
    return at[:, :2] / at[:, 2:]


def draw(image: np.ndarray, corners: np.ndarray, color: int) -> None:
    cv2.fillConvexPoly(image, np.rint(corners * 16).astype(np.int32), color, cv2.LINE_AA, 4)


def video(turn: np.ndarray) -> VideoEvidence:
    """A door with a window, and an edge beside it that does not move."""
    door = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    gray = np.full((len(turn), 240, 320), 90, np.uint8)
    moving = np.zeros(gray.shape, np.uint8)
    for image, mask, angle in zip(gray, moving, turn, strict=True):
        cv2.line(image, *STILL, 200, 2, cv2.LINE_AA)
        draw(image, pixels(door, angle), 160)
        draw(image, pixels(0.2 + 0.5 * door, angle), 30)
        draw(mask, pixels(door, angle), 1)
    none = np.zeros(0, np.float32)
    return VideoEvidence((0, 0), K, moving.astype(bool), gray.astype(np.float32), none, none, None,
                         none, none, ImageSettings())


def adjusted(edges: DoorEdges, turn: np.ndarray) -> np.ndarray:
    """[T] turns after steps by the edges alone."""
    turn = turn.copy()
    for _ in range(10):
        matrix, vector = edges.equations(turn, 6.0, SETTINGS)
        turn[1:] += np.linalg.solve(matrix, vector)
    return turn


def edges_across(door: VideoEvidence, axis: np.ndarray) -> DoorEdges | None:
    return see_edges(planes_of_moving_edges(door, SETTINGS), axis, SETTINGS)


def tilts(ends: np.ndarray) -> DoorEdges:
    """Those of one edge [1 2 2] in each frame."""
    planes = EdgePlanes.of_ends(list(ends[:, None]), K, SETTINGS)
    return measure_tilts(planes, AXIS, SETTINGS)


@pytest.fixture(scope="module")
def seen() -> DoorEdges:
    edges = edges_across(video(TURN), AXIS)
    assert edges is not None
    return edges


def test_the_edge_across_the_axis_has_the_tilt_of_the_door() -> None:
    lower = np.array([[0.0, 1], [1, 1]])
    ends = np.stack([pixels(lower, angle) for angle in TURN])
    found = tilts(ends)
    tilt, sigma = found.tilt, found.sigma
    assert np.mod(tilt - tilt[0] - TURN + 1, np.pi) == pytest.approx(np.full(12, 1.0), abs=1e-9)
    moved = ends + np.array([[[0, 0.35], [0, -0.35]]])
    error = np.abs(tilts(moved).tilt - tilt)
    assert np.all(error < 3 * sigma)


def test_an_edge_along_the_axis_shows_no_tilt() -> None:
    side = pixels(np.array([[1.0, 0], [1, 1]]), -0.3)[None]
    assert len(tilts(side).tilt) == 0


def test_edges_correct_a_turn_that_is_wrong_by_a_share(seen: DoorEdges) -> None:
    found = adjusted(seen, 0.93 * TURN)
    assert np.degrees(np.abs(found - TURN).max()) < 0.3


def test_the_misfit_is_least_at_the_true_turns(seen: DoorEdges) -> None:
    true, *others = (seen.misfit(share * TURN, SETTINGS) for share in (1.0, 0.9, 1.1))
    assert true < 0.1
    assert min(others) > true + 0.1


def test_edges_alone_show_the_turns(seen: DoorEdges) -> None:
    assert np.degrees(np.abs(seen.turns(len(TURN), SETTINGS) - TURN).max()) < 2.0


def test_edges_that_are_not_across_the_axis_do_not_count() -> None:
    slanted = se3.so3_exp(np.array([0.5, 0.2, 0.6])) @ AXIS
    assert edges_across(video(TURN), slanted) is None


def test_turns_of_the_first_frames_are_compared_with_their_edges(seen: DoorEdges) -> None:
    matrix, vector = seen.equations(TURN[:5], 3.0, SETTINGS)
    assert matrix.shape == (4, 4) and vector.shape == (4,)
    assert seen.misfit(TURN[:5], SETTINGS) < 0.1


def test_edges_that_do_not_move_are_left_out() -> None:
    door = video(TURN)
    near = door.moving.copy()
    near[:, 25:42, 15:115] = True  # a foreground that is too large
    found = moving_edges(door.gray, near, door.settings)
    middle = np.concatenate(found).mean(axis=1)
    assert len(middle) > 12
    assert np.abs(middle - STILL.mean(axis=0)).max(axis=1).min() > 10
    settings = ImageSettings(still_edge_share=1.0)
    middle = np.concatenate(moving_edges(door.gray, near, settings)).mean(axis=1)
    assert np.abs(middle - STILL.mean(axis=0)).max(axis=1).min() < 10


def test_edges_do_not_count_where_few_frames_show_any() -> None:
    plain = video(TURN)
    plain.gray[:9] = 90
    assert edges_across(plain, AXIS) is not None
    plain.gray[9] = 90
    assert edges_across(plain, AXIS) is None


def test_frames_without_edges_say_nothing(seen: DoorEdges) -> None:
    later = DoorEdges(seen.frame + 5, seen.tilt, seen.sigma)
    matrix, vector = later.equations(TURN[:5], 3.0, SETTINGS)
    assert not matrix.any() and not vector.any()
    assert later.misfit(TURN[:5], SETTINGS) == 0.0
