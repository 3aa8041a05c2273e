"""Motions of a door by its outline: a box that also turns through the line of sight."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from gcbench.gcpose.chain.articulation import Articulation
from gcbench.gcpose.estimator.hypothesis import Hypothesis
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import VideoEvidence
from gcbench.gcpose.rgb.door_outline import outline_misfit, search_outlines
from gcbench.gcpose.rgb.door_planes import vary_by_outline
from gcbench.gcpose.rgb.points import InverseDepthPoints
from gcbench.gcpose.rgb.settings import RgbSettings
from gcbench.robots.geometry import se3

SETTINGS = replace(RgbSettings(), outlines_kept=8)
K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
AXIS = np.array([0.99, 0.1, 0.05]) / np.linalg.norm([0.99, 0.1, 0.05])
FOOT = np.array([0.0, 0.45, 1.5])
TURN = np.radians(np.linspace(0, 105, 16))
"""The door of `corners` opens towards the camera, and is seen from above at the end."""


def corners(thickness: float = 0.04) -> np.ndarray:
    """[8 3] of a door that stands on its hinge, the front face first."""
    up = np.cross([0.0, 0.0, -1.0], AXIS)
    up /= -np.linalg.norm(up) * np.sign(up[1])
    behind = np.cross(AXIS, up)
    behind *= np.sign(behind[2])
    front = [FOOT + a * AXIS + b * up for a, b in
             ((-0.2, 0.0), (0.2, 0.0), (0.2, 0.36), (-0.2, 0.36))]
    return np.array([*front, *(p + thickness * behind for p in front)])


def door_masks(turn: np.ndarray, shift: int = 0) -> np.ndarray:
    """[T 240 320] of the door, whose image is moved down by some px."""
    out = np.zeros((len(turn), 240, 320), np.uint8)
    for image, angle in zip(out, turn, strict=True):
        at = ((corners() - FOOT) @ se3.so3_exp(angle * AXIS).T + FOOT) @ K.T
        pixel = np.rint(at[:, :2] / at[:, 2:] + [0, shift]).astype(np.int32)
        cv2.fillConvexPoly(image, cv2.convexHull(pixel), 1)
    return out.astype(bool)


def video(moving: np.ndarray, shift: int = 0) -> VideoEvidence:
    none = np.zeros(0, np.float32)
    k = K + np.array([[0, 0, 0], [0, 0, shift], [0, 0, 0]])
    return VideoEvidence((0, 0), k, moving, none, none, None, none, none, ImageSettings())


def motion(turn: np.ndarray, foot: np.ndarray = FOOT) -> Articulation:
    line = np.concatenate([AXIS, np.cross(foot, AXIS)])[None]
    return Articulation(line, turn[:, None], np.zeros(1, bool), np.array([-1]))


def away(turn: np.ndarray, true: np.ndarray = TURN) -> float:
    return float(np.degrees(np.abs(turn - true).max()))


def test_the_door_passes_the_line_of_sight() -> None:
    """Else the tests below would show less than they say."""
    area = door_masks(TURN).sum(axis=(1, 2))
    least = int(area.argmin())
    assert 0 < least < len(area) - 1 and area[least] < 0.6 * min(area[0], area[-1])


def test_an_outline_shows_the_motion_also_where_a_door_is_seen_edge_on() -> None:
    found = search_outlines(video(door_masks(TURN)), AXIS, None, SETTINGS)
    assert 1 < len(found) <= SETTINGS.outlines_kept
    assert min(away(door.turn) for door in found[:3]) < 3.0
    back = search_outlines(video(door_masks(TURN[::-1])), AXIS, None, SETTINGS)
    assert min(away(door.turn, TURN[::-1] - TURN[-1]) for door in back[:3]) < 3.0


def test_a_door_that_leaves_the_image_is_followed() -> None:
    masks = door_masks(TURN, 25)
    assert masks[:, -1].any() and not masks[0, -1].any()
    found = search_outlines(video(masks, 25), AXIS, None, SETTINGS)
    assert min(away(door.turn) for door in found[:3]) < 6.0


def test_a_known_hinge_stays_in_its_place() -> None:
    found = search_outlines(video(door_masks(TURN)), AXIS, FOOT, SETTINGS)
    across = FOOT - AXIS * (AXIS @ FOOT)
    for door in found:
        assert np.allclose(door.foot / np.linalg.norm(door.foot),
                           across / np.linalg.norm(across), atol=1e-3)
    assert away(found[0].turn) < 2.5


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_the_misfit_is_least_at_the_true_motion(factor: float) -> None:
    seen = video(door_masks(TURN))
    right = outline_misfit(seen, motion(TURN), SETTINGS)
    assert right < 0.5
    assert outline_misfit(seen, motion(factor * TURN), SETTINGS) > 2 * right
    assert np.isclose(outline_misfit(seen, motion(TURN, 1.7 * FOOT), SETTINGS), right, rtol=0.05)


def test_points_are_on_the_face_that_is_seen() -> None:
    """In the first frame, the front face is seen, and in the last one the back."""
    (door, *_) = search_outlines(video(door_masks(TURN)), AXIS, FOOT, SETTINGS)
    last = len(TURN) - 1
    true = motion(door.turn).motions(len(TURN))[:, 1]
    middle = corners().reshape(2, 4, 3).mean(axis=1)  # of both faces in frame 0
    here = np.array([middle[0], true[last, :3, :3] @ middle[1] + true[last, :3, 3]])
    points = InverseDepthPoints.without_measurements(
        np.repeat([0, last], 40), np.repeat(here / here[:, 2:], 40, axis=0),
        np.ones(80, np.int64), np.ones(80))
    start = Hypothesis(motion(TURN), points, here[0], np.inf)
    (found,) = vary_by_outline(start, [door], SETTINGS)
    depth = 1 / found.points.inverse_depth[[0, 40]]
    assert np.allclose(depth / depth[0], here[:, 2] / here[0, 2], atol=0.01)
    assert np.array_equal(found.state.angle[:, 0], door.turn)
    thin = replace(door, offset=door.offset[:1].repeat(2))
    (flat,) = vary_by_outline(start, [thin], SETTINGS)
    assert abs(1 / flat.points.inverse_depth[40] / depth[1] - 1) > 0.01


def test_nothing_is_found_where_nothing_moves() -> None:
    empty = video(np.zeros((5, 60, 80), bool))
    assert search_outlines(empty, AXIS, None, SETTINGS) == []
    assert outline_misfit(empty, motion(TURN[:5]), SETTINGS) == 0.0
