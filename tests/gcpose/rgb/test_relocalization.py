"""Frames in which a part was lost: found again where it jumps, and doubted where it is hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.gcpose.chain.articulation import Articulation
from gcbench.gcpose.chain.priors import JointPriors
from gcbench.gcpose.images.flow import dis_flow
from gcbench.gcpose.images.foreground import subtract_background
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import FrontEnd, video_evidence
from gcbench.gcpose.method import GCPose
from gcbench.gcpose.rgb.door_edges import DoorEdges
from gcbench.gcpose.rgb.evidence import RgbEvidence, VideoHypothesis
from gcbench.gcpose.rgb.points import InverseDepthPoints
from gcbench.gcpose.rgb.relocalization import (
    displaced_by_edges,
    displaced_by_patches,
    find_doubtful_frames,
    find_lost_frames,
    frames_without_path,
)
from gcbench.gcpose.rgb.settings import RgbSettings
from gcbench.gcpose.settings import Settings

from ...support.ray_scenes import door, drawer, texture

STEADY = np.linspace(0, 0.6, 7)
SETTINGS = RgbSettings()


@pytest.fixture(scope="module")
def opened() -> VideoHypothesis:
    """The motion of a door, refined from its true one."""
    evidence = without_edges()
    direction = evidence.priors.direction
    assert direction is not None
    points = evidence.sample(evidence.final_keys, 100)
    line = np.concatenate([direction[0], np.cross([-0.15, 0.0, 1.2], direction[0])])[None]
    state = Articulation(line, 0.5 * np.linspace(0, 1, 8)[:, None], evidence.priors.prismatic,
                         evidence.priors.parent)
    start = InverseDepthPoints.without_measurements(
        points.frame, points.ray, np.ones(len(points.frame), np.int64), points.expected)
    found = evidence.label(VideoHypothesis(state, start, points.ray[0], np.inf), points)
    return evidence.refine_by_patches(found, points, 3, SETTINGS.patch_reach_first)


def without_edges() -> RgbEvidence:
    observation = door(0.5)
    direction = observation.axis_direction
    front = FrontEnd(dis_flow, lambda rgb: subtract_background(rgb, ImageSettings()))
    video = video_evidence(observation, front, ImageSettings())
    assert video is not None and direction is not None
    priors = JointPriors(np.zeros(1, bool), np.array([-1]), direction, None)
    evidence = RgbEvidence(video, priors, SETTINGS)
    evidence.edges = None
    return evidence


def edges_of(turn: np.ndarray, each: int) -> DoorEdges:
    """Some edges across the axis in each frame of a door with turns."""
    n = len(turn)
    return DoorEdges(np.repeat(np.arange(n), each), np.repeat(0.4 + turn, each),
                     np.full(each * n, 0.003))


def moved(hypothesis: VideoHypothesis, last: float) -> VideoHypothesis:
    angle = hypothesis.state.angle.copy()
    angle[-1] += last
    return replace(hypothesis, state=replace(hypothesis.state, angle=angle))


def test_a_frame_that_patches_do_not_link_is_lost_and_found(opened: VideoHypothesis) -> None:
    evidence = without_edges()
    assert not find_lost_frames(evidence, opened).any()
    wrong = moved(opened, -0.25)
    lost = find_lost_frames(evidence, wrong)
    assert np.flatnonzero(lost).tolist() == [7]
    found, sure = displaced_by_patches(evidence, wrong, lost)
    assert sure.tolist() == lost.tolist()
    assert found[-1] == pytest.approx(0.5, abs=SETTINGS.relocalization_step)


def test_edges_link_frames_and_contradict_links(opened: VideoHypothesis) -> None:
    evidence, turn = without_edges(), opened.state.angle[:, 0]
    none, every = (np.full(len(opened.points.frame), used) for used in (False, True))
    assert frames_without_path(evidence, opened, none).tolist() == [False] + 7 * [True]
    evidence.edges = edges_of(turn, 3)
    assert not frames_without_path(evidence, opened, none).any()
    evidence.edges = edges_of(turn, 2)  # too few
    assert frames_without_path(evidence, opened, none)[1:].all()
    evidence.edges = edges_of(turn + np.append(0.3, np.zeros(7)), 3)
    doubtful = find_doubtful_frames(evidence, opened)  # edges contradict frame 0
    assert not doubtful[0] and doubtful[1:].all()
    for each, lost in ((3, [7]), (2, [])):
        evidence.edges = edges_of(turn - np.append(np.zeros(7), 0.3), each)
        assert np.flatnonzero(frames_without_path(evidence, opened, every)).tolist() == lost


def test_edges_tell_the_displacements_of_lost_frames(opened: VideoHypothesis) -> None:
    evidence, turn = without_edges(), opened.state.angle[:, 0]
    before, lost = turn.copy(), np.arange(8) >= 6
    before[lost] = turn[5]
    for each in (3, 2):
        evidence.edges = edges_of(turn, each)
        found, sure = displaced_by_edges(evidence, before, lost)
        assert sure.tolist() == (lost & (each == 3)).tolist()
        assert found[lost] == pytest.approx(turn[lost], abs=SETTINGS.edge_relocalization_step)
    vague = edges_of(turn, 3)
    evidence.edges = replace(vague, sigma=np.full(24, 0.1))
    assert not displaced_by_edges(evidence, before, lost)[1].any()


def test_a_door_that_jumps_is_found_again() -> None:
    pace = np.array([*STEADY, 1.0])
    found = GCPose().estimate(door(0.8, pace=pace))
    assert found.displacement[:, 0] == pytest.approx(0.8 * pace, abs=np.radians(1.0))
    assert found.reliable is not None and found.reliable.all()


@pytest.mark.ci
def test_a_door_that_turns_back_at_once_is_found_again() -> None:
    pace = np.array([*STEADY, 0.2, 0.1])
    found = GCPose().estimate(door(0.8, pace=pace))
    assert found.displacement[:, 0] == pytest.approx(0.8 * pace, abs=np.radians(1.0))


def test_a_drawer_that_jumps_is_found_again() -> None:
    pace = np.array([*STEADY, 1.0])
    found = GCPose().estimate(drawer(0.25, pace=pace), object_depth=1.15)
    assert found.displacement[:, 0] == pytest.approx(0.25 * pace, abs=0.01)


def test_a_frame_in_which_the_part_is_hidden_is_not_reliable() -> None:
    seen = door(0.5)
    assert seen.rgb is not None
    hidden = seen.rgb.copy()
    hidden[-1, 30:150, 60:200] = texture(np.random.default_rng(3), 120, 140, 4.0)
    for rgb, reliable in ((seen.rgb, True), (hidden, False)):
        found = GCPose().estimate(replace(seen, rgb=rgb))
        assert found.sigma is not None and found.reliable is not None
        assert found.reliable[0] == reliable
        assert found.displacement[-2, 0] == pytest.approx(0.5 * 6 / 7, abs=np.radians(2.0))
        assert found.sigma[-2, 0] < np.radians(3.0)
    assert found.sigma[-1, 0] >= Settings().rgb.lost_deviation
