"""Straight edges of a door show where its axis points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.gcpose.chain import JointPriors
from gcbench.gcpose.rgb.door_axis import DoorAxis, find_axis, refine_axis
from gcbench.gcpose.rgb.edge_planes import EdgePlanes
from gcbench.gcpose.rgb.evidence import RgbEvidence
from gcbench.gcpose.rgb.settings import RgbSettings
from gcbench.robots.geometry import se3

from . import test_door_edges

SETTINGS = RgbSettings()
K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
AXIS = np.array([0.1, 0.9, 0.35]) / np.linalg.norm([0.1, 0.9, 0.35])
ACROSS = np.cross(AXIS, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(AXIS, [0.0, 0.0, 1.0]))
TURN = np.radians(np.linspace(0, -40, 12))
NOISE = np.random.default_rng(3)


def edges_of(lines: np.ndarray, turn: np.ndarray, noise: float = 0.15) -> EdgePlanes:
    """Lines [N 2 3] on a door, by their places across it, along its axis and out of it, m, at each
    of its turns; with noise of the ends, px."""
    out = []
    for angle in turn:
        axes = np.stack([ACROSS, AXIS, np.cross(ACROSS, AXIS)])
        at = lines @ axes @ se3.so3_exp(angle * AXIS).T + [-0.2, 0.0, 1.5]
        pixel = at @ K.T
        out.append(pixel[..., :2] / pixel[..., 2:] + noise * NOISE.normal(size=(*at.shape[:2], 2)))
    return EdgePlanes.of_ends(out, K, SETTINGS)


def rectangle(left: float, right: float, low: float, high: float) -> np.ndarray:
    corner = np.array([[left, low, 0], [right, low, 0], [right, high, 0], [left, high, 0]])
    return np.stack([corner, np.roll(corner, -1, axis=0)], axis=1)


DOOR = np.concatenate([rectangle(0.0, 0.5, -0.3, 0.3), rectangle(0.1, 0.3, -0.1, 0.2)])
NONE = EdgePlanes.of_ends([np.zeros((0, 2, 2))], K, SETTINGS)


def degrees_off(axis: DoorAxis) -> float:
    return float(np.degrees(np.arccos(min(1.0, abs(axis.direction @ AXIS)))))


def test_the_axis_of_a_door_is_found() -> None:
    found = find_axis(edges_of(DOOR, TURN), NONE, SETTINGS)
    assert found is not None
    assert degrees_off(found) < 0.5
    cosine = np.abs(found.across @ found.across[0])
    assert cosine == pytest.approx(np.cos(TURN), abs=0.01)
    assert found.explained > 0.9
    assert 0 < found.turn_deviation()[-1] < np.radians(1)


def test_edges_that_stand_still_make_the_axis_more_exact() -> None:
    moving = edges_of(DOOR, TURN[[0, 5, 11]], noise=0.5)
    beside = np.array([[[-0.4, -0.3, 0], [-0.4, 0.3, 0]], [[0.9, -0.3, 0.2], [0.9, 0.3, 0.2]]])
    still = edges_of(beside, np.zeros(1), noise=0.05)
    alone, both = (refine_axis(moving, each, AXIS, SETTINGS) for each in (NONE, still))
    assert both.deviation < 0.8 * alone.deviation


def test_slanted_edges_do_not_tell_an_axis() -> None:
    corner = NOISE.uniform(-0.3, 0.3, (12, 3))
    assert find_axis(edges_of(corner.reshape(6, 2, 3), TURN), NONE, SETTINGS) is None


def test_edges_of_one_direction_show_no_wrong_axis() -> None:
    sides = DOOR[[1, 3, 5, 7]]
    found = find_axis(edges_of(sides, TURN), NONE, SETTINGS)
    assert found is not None and degrees_off(found) < 1.0
    tops = DOOR[[0, 2, 4, 6]]
    found = find_axis(edges_of(tops, TURN), NONE, SETTINGS)
    assert found is None or degrees_off(found) < 3.0


def test_a_door_without_edges_has_no_known_axis() -> None:
    assert find_axis(NONE, NONE, SETTINGS) is None


def test_a_door_in_a_video_has_the_axis_of_its_edges() -> None:
    unknown = JointPriors(np.array([False]), np.array([-1]), None, None)
    seen = RgbEvidence(test_door_edges.video(TURN), unknown, SETTINGS).with_axis_by_edges()
    assert seen.priors.direction is not None and seen.edges is not None
    assert abs(seen.priors.direction[0] @ test_door_edges.AXIS) > np.cos(np.radians(1))
    for settings, priors in ((replace(SETTINGS, edge_weight=0.0), unknown),
                             (SETTINGS, replace(unknown, prismatic=np.array([True])))):
        other = RgbEvidence(seen.video, priors, settings)
        assert other.with_axis_by_edges() is other
