"""Straight edges of a drawer show the directions of its box."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import VideoEvidence
from gcbench.gcpose.rgb.box_directions import BoxDirections, find_box_directions
from gcbench.gcpose.rgb.edge_planes import EdgePlanes
from gcbench.gcpose.rgb.focal_length import find_focal_length
from gcbench.gcpose.rgb.settings import RgbSettings
from gcbench.robots.geometry import se3

SETTINGS = RgbSettings()
K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
BOX = se3.so3_exp(np.array([0.35, -0.5, 0.05])).T
"""Its directions in rows: to the right, down, and along the slide"""
RNG = np.random.default_rng(8)


def edges_of(lines: np.ndarray, slides: np.ndarray, noise: float = 0.15) -> EdgePlanes:
    """Lines [N 2 3] of the box, m, after each of its slides; with noise of the ends, px."""
    out = []
    for slide in slides:
        at = (lines - [0, 0, slide]) @ BOX + [0.0, 0.05, 1.5]
        pixel = at @ K.T
        out.append(pixel[..., :2] / pixel[..., 2:] + noise * RNG.normal(size=(*at.shape[:2], 2)))
    return EdgePlanes.of_ends(out, K, SETTINGS)


def rectangle(width: float, height: float, depth: float = 0.0) -> np.ndarray:
    corner = np.array([[-width, -height, depth], [width, -height, depth], [width, height, depth],
                       [-width, height, depth]]) / 2
    return np.stack([corner, np.roll(corner, -1, axis=0)], axis=1)


FRONT = np.concatenate([rectangle(0.5, 0.25), rectangle(0.12, 0.03)])
SIDES = np.array([[[x, -0.1, 0.0], [x, -0.1, 0.3]] for x in (-0.3, 0.3)])
SLIDES = np.linspace(0, 0.2, 8)
NONE = EdgePlanes.of_ends([np.zeros((0, 2, 2))], K, SETTINGS)


def degrees_off(box: BoxDirections | None) -> float:
    """Of the direction that is nearest to the slide."""
    assert box is not None
    return float(np.degrees(np.arccos(min(1.0, abs(box.nearest_first(BOX[2])[0] @ BOX[2])))))


def test_the_front_of_a_drawer_tells_where_it_slides() -> None:
    found = find_box_directions(edges_of(FRONT, SLIDES), NONE, SETTINGS)
    assert degrees_off(found) < 1.0
    assert found is not None and found.explained > 0.9
    assert found.axes @ found.axes.T == pytest.approx(np.eye(3), abs=1e-9)


def test_edges_that_stand_still_make_the_directions_more_exact() -> None:
    front = edges_of(FRONT, SLIDES[[0, 3, 7]], noise=0.5)
    sides = edges_of(SIDES, np.zeros(1), noise=0.05)
    alone, both = (find_box_directions(front, still, SETTINGS) for still in (NONE, sides))
    assert alone is not None and both is not None
    assert both.deviation < 0.5 * alone.deviation
    assert degrees_off(both) < 0.5


def test_edges_of_no_box_tell_nothing() -> None:
    corner = RNG.uniform(-0.3, 0.3, (12, 3))
    slanted = np.stack([corner[:6], corner[6:]], axis=1)
    assert find_box_directions(edges_of(slanted, SLIDES), NONE, SETTINGS) is None
    level = FRONT[np.abs(np.ptp(FRONT, axis=1)[:, 1]) < 1e-9]
    assert find_box_directions(edges_of(level, SLIDES), NONE, SETTINGS) is None
    assert find_box_directions(NONE, NONE, SETTINGS) is None


def video_of(slides: np.ndarray) -> VideoEvidence:
    """A drawer that slides out of a box, of which the top and a side are seen."""
    gray = np.full((len(slides), 480, 640), 90, np.uint8)
    moving = np.zeros(gray.shape, np.uint8)
    corner = np.array([[-0.3, -0.2, 0.0], [0.3, -0.2, 0.0], [0.3, 0.2, 0.0], [-0.3, 0.2, 0.0]])
    back = corner + np.array([0, 0, 0.4])
    front = np.array([[-0.25, 0, 0], [0.25, 0, 0], [0.25, 0.17, 0], [-0.25, 0.17, 0]])
    panel = np.array([[-0.15, 0.04, 0], [0.15, 0.04, 0], [0.15, 0.13, 0], [-0.15, 0.13, 0]])

    def draw(image: np.ndarray, points: np.ndarray, color: int) -> None:
        at = (points @ BOX + [0.0, 0.05, 1.5]) @ K.T
        place = np.rint(16 * at[:, :2] / at[:, 2:]).astype(np.int32)
        cv2.fillConvexPoly(image, place, color, cv2.LINE_AA, 4)

    for image, mask, slide in zip(gray, moving, slides, strict=True):
        draw(image, np.stack([*corner[:2], *back[1::-1]]), 200)
        draw(image, np.stack([*corner[[0, 3]], *back[[3, 0]]]), 60)
        draw(image, np.stack([*corner[[1, 2]], *back[[2, 1]]]), 60)
        draw(image, corner, 130)
        draw(image, front - [0, 0, slide], 170)
        draw(image, panel - [0, 0, slide], 30)
        draw(mask, front - [0, 0, slide], 1)
    none = np.zeros(0, np.float32)
    return VideoEvidence((0, 0), K, moving.astype(bool), gray.astype(np.float32), none, none, None,
                         none, none, ImageSettings())


@pytest.mark.ci
def test_the_focal_length_of_a_drawer_that_slides_is_found() -> None:
    wrong = K.copy()
    wrong[[0, 1], [0, 1]] = 380.0
    seen = replace(video_of(SLIDES), intrinsics=wrong)
    assert find_focal_length(seen, SETTINGS, slides=True) == pytest.approx(K[0, 0], rel=0.1)
    seen.gray[:] = 90
    assert find_focal_length(seen, SETTINGS, slides=True) is None
