"""Doors on plain video: planes through and along the axis, other turns, and depths that stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.gcpose.chain.articulation import Articulation
from gcbench.gcpose.chain.priors import JointPriors, joint_priors
from gcbench.gcpose.estimator.em import adjust
from gcbench.gcpose.images.flow import dis_flow
from gcbench.gcpose.images.foreground import subtract_background
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import FrontEnd, video_evidence
from gcbench.gcpose.rgb import pipeline
from gcbench.gcpose.rgb.door_edges import DoorEdges
from gcbench.gcpose.rgb.door_planes import (
    bridge_edge_on,
    edge_on_frames,
    exchange_door_turn,
    fit_plane_motion,
    fit_turns,
    inverse_depths_on_plane,
    is_door,
    search_depths,
    turn_by_edges,
    vary_door_plane,
)
from gcbench.gcpose.rgb.door_search import search_door, search_edge_on
from gcbench.gcpose.rgb.evidence import RgbEvidence, VideoAdjustment, VideoHypothesis
from gcbench.gcpose.rgb.points import InverseDepthPoints, interpolate_depths, predict_places
from gcbench.gcpose.rgb.scores import score_hypothesis
from gcbench.gcpose.rgb.search import SearchResult, exchange_parallel_turns
from gcbench.gcpose.rgb.settings import RgbSettings

from ...support.ray_scenes import FRAMES, INTRINSICS, chain, door

SETTINGS = RgbSettings()
FOOT = np.array([-0.15, 0.0, 1.2])
CORNERS = np.array([[-0.15, -0.16, 1.2], [0.2, -0.16, 1.1], [0.2, 0.16, 1.1]])
"""Of the panel of `door`"""


def one_joint(turn: float = 1.0) -> Articulation:
    whole, _ = chain()
    return replace(whole, twist=whole.twist[:1], angle=turn * whole.angle[:, :1],
                   prismatic=whole.prismatic[:1], parent=whole.parent[:1])


def panel(state: Articulation, slope: float = 0.8) -> tuple[VideoHypothesis, np.ndarray, float]:
    """Points of two key frames on a plane through the axis, with its normal and its offset."""
    _, at = chain()
    normal = np.cross(state.twist[0, :3], [slope, 0.1, 0.4])
    normal /= np.linalg.norm(normal)
    pixel = np.random.default_rng(9).uniform([60, 60], [150, 180], (200, 2))
    ray = np.column_stack([(pixel - INTRINSICS[:2, 2]) / 600.0, np.ones(200)])
    points = InverseDepthPoints.without_measurements(
        np.repeat([0, 4], 100), ray, np.ones(200, np.int64), np.ones(200))
    offset = float(normal @ at[0])
    depths, _ = inverse_depths_on_plane(state, points, normal, offset)
    points = replace(points, inverse_depth=depths)
    return VideoHypothesis(state, points, at[0], 3.0), normal, offset


def test_points_stay_on_the_plane_of_their_part() -> None:
    state = one_joint()
    found, normal, offset = panel(state)
    points = found.points
    back = np.linalg.inv(state.motions(FRAMES)[points.frame, 1])
    place = np.column_stack([points.ray / points.inverse_depth[:, None], np.ones(200)])
    assert np.allclose(np.einsum("nab,nb->na", back, place)[:, :3] @ normal, offset)
    _, slope = inverse_depths_on_plane(state, points, normal, offset)
    aside = replace(points, ray=points.ray + np.array([0.01, -0.02, 0.0]))
    there, _ = inverse_depths_on_plane(state, aside, normal, offset)
    assert np.allclose(there - points.inverse_depth, slope @ [0.01, -0.02])


def test_a_door_may_lie_in_any_plane_through_its_axis() -> None:
    """One of them is about the true one, at a scale at which points are about at 1."""
    state = one_joint()
    start, _, _ = panel(state)
    true = start.points.inverse_depth
    found = vary_door_plane(start, SETTINGS)
    assert len(found) > 2
    assert all(abs(np.median(g.points.inverse_depth) - 1.0) < 0.05 for g in found)
    off = [np.abs(g.points.inverse_depth - true / np.median(true)).max() for g in found]
    assert min(off) < 0.05 < np.abs(1.0 - true / np.median(true)).max()
    best = found[int(np.argmin(off))].state.twist[0]
    assert np.allclose(best[3:], np.median(true) * state.twist[0, 3:], rtol=0.05)


def test_only_one_turning_part_is_a_door() -> None:
    whole, _ = chain()
    start, _, _ = panel(one_joint())
    slide = replace(start, state=replace(start.state, prismatic=np.ones(1, bool)))
    several = replace(start, state=whole)
    assert is_door(start.state) and not is_door(slide.state) and not is_door(whole)
    for other in (slide, several):
        assert not vary_door_plane(other, SETTINGS)
        assert not exchange_door_turn(other, INTRINSICS, SETTINGS)


def test_a_plane_and_its_hinge_are_found_from_two_images() -> None:
    state = one_joint(1.6)
    found, normal, offset = panel(state)
    place = predict_places(state, found.points, INTRINSICS)[:100].swapaxes(0, 1)
    place = (place - INTRINSICS[:2, 2]) / 600.0
    ray, axis, turn = found.points.ray[:100], state.twist[0, :3], float(state.angle[-1, 0])
    wrong = place[-1].copy()
    wrong[:8] += 0.1
    foot, plane = fit_plane_motion(ray, wrong, axis, turn, 0.005)
    scale = np.mean(ray @ normal) / offset  # the mean inverse depth becomes 1
    assert np.allclose(plane, normal / offset / scale, atol=1e-3)
    assert np.allclose(foot, scale * np.cross(axis, state.twist[0, 3:]), atol=1e-2)
    turns = fit_turns(ray, ray @ plane, place, (axis, foot), turn, 0.005)
    assert np.degrees(np.abs(turns - state.angle[:, 0]).max()) < 0.5


def test_other_turns_show_nearly_the_same_images() -> None:
    state = one_joint()
    start, _, _ = panel(state)
    turn = float(state.angle[-1, 0])
    settings = replace(SETTINGS, max_door_turn=3 * turn, door_turn_step=turn)
    found = exchange_door_turn(start, INTRINSICS, settings)
    turns = np.array([g.state.angle[-1, 0] for g in found])
    assert len(found) > 3 and np.ptp(turns) > 2 * turn
    place = predict_places(state, start.points, INTRINSICS)
    apart = [np.linalg.norm(predict_places(g.state, g.points, INTRINSICS) - place, axis=2)[:100]
             for g in found]
    moved = np.linalg.norm(place[:100, -1] - place[:100, 0], axis=1).mean()
    assert min(a[:, -1].mean() for a in apart) < 0.02 * moved


def test_turns_by_edges_come_with_the_plane_that_shows_the_same_motion() -> None:
    state = one_joint()
    start, _, _ = panel(state)
    found = turn_by_edges(start, state.angle[:, 0], INTRINSICS, SETTINGS)
    assert found is not None and np.array_equal(found.state.angle, state.angle)
    true = start.points.inverse_depth / np.median(start.points.inverse_depth)
    assert np.allclose(found.points.inverse_depth, true, atol=1e-6)
    other = turn_by_edges(start, 1.1 * state.angle[:, 0], INTRINSICS, SETTINGS)
    assert other is not None and np.array_equal(other.state.angle, 1.1 * state.angle)
    assert turn_by_edges(start, 0.01 * state.angle[:, 0], INTRINSICS, SETTINGS) is None


def test_edges_decide_about_the_turn_where_patches_hardly_do() -> None:
    """The same points, with edges that show 1.2 times the turn: the estimate follows them."""
    evidence, near, true = door_hypothesis()
    start = replace(near, points=replace(near.points, inverse_depth=true))
    turn = start.state.angle[:, 0]
    frame = np.arange(len(turn))
    found, missed = [], []
    for share in (1.0, 1.2):
        evidence.edges = DoorEdges(frame, 0.4 + share * turn, np.full(len(turn), 0.003))
        h = evidence.refine_by_patches(start, evidence.sample((0, 4), 60), 3, SETTINGS.patch_reach)
        found.append(h.state.angle[-1, 0] / turn[-1])
        missed.append(evidence.edges.misfit(h.state.angle[:, 0], SETTINGS))
    assert found[0] == pytest.approx(1.0, abs=0.02)
    assert found[1] == pytest.approx(1.2, abs=0.05)
    assert max(missed) < 0.2


def test_edges_that_a_motion_does_not_explain_count_in_its_score() -> None:
    evidence, near, _ = door_hypothesis()
    turn, frame = near.state.angle[:, 0], np.arange(len(near.state.angle))
    evidence.edges = DoorEdges(frame, 2 * turn, np.full(len(turn), 0.003))
    penalties = []
    for weight in (0.0, 2.0):
        evidence.settings = replace(SETTINGS, edge_weight=0.0, score_edges=weight)
        h = evidence.refine_by_patches(near, evidence.sample((0, 4), 60), 1, SETTINGS.patch_reach)
        penalties.append(h.penalty)
    missed = evidence.edges.misfit(h.state.angle[:, 0], SETTINGS)
    assert missed > 0.2
    assert penalties[1] - penalties[0] == pytest.approx(2 * missed)


@pytest.mark.parametrize("counts", [True, False])
def test_a_door_whose_edges_count_has_deviations_of_its_own(
    counts: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    evidence, near, _ = door_hypothesis()
    found = evidence.refine_by_patches(
        near, evidence.sample((0, 4), 60), 1, SETTINGS.patch_reach)
    edges = DoorEdges(np.zeros(1, np.int64), np.zeros(1), np.ones(1)) if counts else None
    monkeypatch.setattr(RgbEvidence, "edges", edges)
    monkeypatch.setattr(pipeline, "search_video", lambda seen: SearchResult(found, []))
    monkeypatch.setattr(pipeline, "find_doubtful_frames", lambda *_: np.zeros(8, bool))
    observation = door(0.5)
    front = FrontEnd(dis_flow, lambda rgb: subtract_background(rgb, ImageSettings()))
    estimate = pipeline.estimate_rgb(
        observation, joint_priors(observation), front, SETTINGS, ImageSettings())
    assert estimate is not None and estimate.sigma is not None
    own = SETTINGS.deviation_edges if counts else SETTINGS.deviation
    expected = pipeline.reported_deviation(
        SearchResult(found, []), replace(SETTINGS, deviation=own))
    assert np.array_equal(estimate.sigma, expected)


def door_hypothesis() -> tuple[RgbEvidence, VideoHypothesis, np.ndarray]:
    """A door with its true motion, its points too near, and their true inverse depths."""
    observation = door(0.5)
    direction = observation.axis_direction
    assert direction is not None
    front = FrontEnd(dis_flow, lambda rgb: subtract_background(rgb, ImageSettings()))
    video = video_evidence(observation, front, ImageSettings())
    assert video is not None
    priors = JointPriors(np.zeros(1, bool), np.array([-1]), direction, None)
    evidence = RgbEvidence(video, priors, SETTINGS)
    points = evidence.sample((0, 4), 60)
    line = np.concatenate([direction[0], np.cross(FOOT, direction[0])])[None]
    state = Articulation(line, 0.5 * observation.times[:, None], priors.prismatic, priors.parent)
    start = InverseDepthPoints.without_measurements(
        points.frame, points.ray, np.ones(len(points.frame), np.int64), points.expected)
    found = evidence.label(VideoHypothesis(state, start, points.ray[0], np.inf), points)
    normal = np.cross(CORNERS[1] - CORNERS[0], CORNERS[2] - CORNERS[0])
    depths, _ = inverse_depths_on_plane(
        state, found.points, normal, float(normal @ CORNERS[0]))
    near = replace(found.points, inverse_depth=np.full(len(depths), 1.3 * depths.mean()))
    return evidence, replace(found, points=near), depths


def test_depths_are_searched_on_planes() -> None:
    evidence, near, true = door_hypothesis()
    fine = replace(SETTINGS, plane_tilts=12, plane_depths=tuple(np.linspace(0.8, 1.4, 16)))
    found = search_depths(evidence.video, near, fine)
    before, after = (np.abs(h.points.inverse_depth - true) for h in (near, found))
    assert np.median(after) < 0.2 * np.median(before)
    exact = replace(near, points=replace(near.points, inverse_depth=true))
    kept = search_depths(evidence.video, exact, SETTINGS)
    assert np.mean(kept.points.inverse_depth == true) > 0.7


@pytest.mark.ci
def test_a_door_that_turns_the_wrong_way_is_mended() -> None:
    evidence, near, true = door_hypothesis()
    state = replace(near.state, angle=-near.state.angle)
    points = replace(near.points, inverse_depth=true)
    sampled = evidence.sample((0, 4), 60)
    wrong = evidence.refine_by_patches(
        replace(near, state=state, points=points), sampled, 2, SETTINGS.patch_reach)
    assert wrong.state.angle[-1, 0] < 0
    found = search_door(evidence, [wrong], sampled)
    best = min(found, key=lambda h: score_hypothesis(h, SETTINGS))
    assert score_hypothesis(best, SETTINGS) < score_hypothesis(wrong, SETTINGS)
    assert np.degrees(abs(best.state.angle[-1, 0] - near.state.angle[-1, 0])) < 5


def test_a_door_is_seen_edge_on_where_its_foreground_is_small() -> None:
    evidence, _, _ = door_hypothesis()
    moving = np.zeros((6, 10, 10), np.bool_)
    for t, rows in enumerate((9, 8, 7, 2, 7, 8)):
        moving[t, :rows] = True
    frames = [edge_on_frames(replace(evidence.video, moving=m), SETTINGS)
              for m in (moving, moving[[3, 0, 1, 2, 4, 5]], moving[[0, 1, 2, 4, 5]])]
    assert frames == [[3, 2, 4], [1], []]


def test_frames_before_an_edge_on_one_give_the_depths_after_it() -> None:
    state = one_joint()
    right, _, _ = panel(state)
    true, late = right.points.inverse_depth, right.points.frame == 4
    depth = np.where(late, 1.2 * true, true)
    wrong = replace(right, points=replace(right.points, inverse_depth=depth))
    found = bridge_edge_on(wrong, [2], SETTINGS)
    still = [h for h in found if np.array_equal(h.state.angle, state.angle)]
    assert len(still) == 2  # the plane of what comes before, and that of what comes after
    assert min(np.abs(h.points.inverse_depth - true).max() for h in still) < 1e-3
    last = {round(float(np.degrees(h.state.angle[-1, 0] - state.angle[-1, 0])), 6)
            for h in found}
    assert last >= {-6.0, -2.5, 0.0, 2.5, 6.0}
    assert all(h.state.angle[0, 0] == 0 for h in found)


@pytest.mark.parametrize("before", [True, False])
def test_a_side_of_an_edge_on_frame_may_turn_and_lie_as_the_other_side(before: bool) -> None:
    state = replace(one_joint(), angle=np.linspace(0.0, 0.5, FRAMES)[:, None])
    right, _, _ = panel(state)
    true, at = right.points.inverse_depth, right.points.frame
    steps = np.diff(state.angle, axis=0)
    steps[slice(None, 2) if before else slice(2, None)] *= -0.1  # turns and lies otherwise
    angle = np.concatenate([np.zeros((1, 1)), np.cumsum(steps, axis=0)])
    depth = np.where((at < 2) == before, 1.2 * true, true)
    wrong = replace(right, state=replace(state, angle=angle),
                    points=replace(right.points, inverse_depth=depth))
    found = bridge_edge_on(wrong, [2], replace(SETTINGS, edge_on_paces=(0.5, 1.0)))
    off = [(np.abs(h.state.angle - state.angle).max(),
            np.abs(h.points.inverse_depth - true).max()) for h in found]
    assert min(turn + away for turn, away in off) < 1e-3
    assert np.degrees(np.abs(angle - state.angle).max()) > 5


def test_a_wrong_turn_across_an_edge_on_frame_is_mended() -> None:
    evidence, near, true = door_hypothesis()
    frames = len(near.state.angle)
    later = np.arange(frames)[:, None] > frames // 2
    state = replace(near.state, angle=near.state.angle + np.radians(9.0) * later)
    start = replace(near, state=state, points=replace(near.points, inverse_depth=true))
    video = replace(evidence.video, moving=evidence.video.moving.copy())
    video.moving[frames // 2, :, ::2] = False  # less of the door is seen here
    seen = RgbEvidence(video, evidence.priors, SETTINGS)
    points = seen.sample((0, 4), 60)
    wrong = seen.refine_by_patches(start, points, 1, 1.0)
    again = seen.refine_by_patches(wrong, points, 2, SETTINGS.patch_reach_first)
    found = search_edge_on(seen, wrong, points)
    away = [np.degrees(np.abs(h.state.angle - near.state.angle).max())
            for h in (wrong, again, found)]
    assert away[2] < 0.8 * away[1] < 0.5 * away[0]  # refinement alone is not enough
    assert score_hypothesis(found, SETTINGS) < score_hypothesis(again, SETTINGS)


def differs_in_unit_only(hypothesis: VideoHypothesis, line: np.ndarray) -> bool:
    """Whether its axes are known ones [J 6] in another unit of length."""
    twist = hypothesis.state.twist
    unit = np.linalg.norm(twist[:, 3:]) / np.linalg.norm(line[:, 3:])
    return np.allclose(twist, line * np.repeat([1.0, unit], 3))


def test_a_known_axis_of_a_door_stays_in_its_place() -> None:
    evidence, near, true = door_hypothesis()
    known = RgbEvidence(
        evidence.video, replace(evidence.priors, line=near.state.twist), SETTINGS)
    sampled = known.sample((0, 4), 60)
    start = replace(near, points=replace(near.points, inverse_depth=true))
    start = known.refine_by_patches(start, sampled, 2, SETTINGS.patch_reach)
    found = search_door(known, [start], sampled)
    assert all(differs_in_unit_only(h, near.state.twist) for h in found)
    free = search_door(evidence, [start], sampled)
    assert not all(differs_in_unit_only(h, near.state.twist) for h in free)


def test_known_parallel_axes_stay_in_their_places() -> None:
    evidence, near, _ = door_hypothesis()
    aside = near.state.twist.copy()
    aside[0, 3:] += np.cross([0.1, 0.0, 0.0], aside[0, :3])
    line, parent = np.concatenate([near.state.twist, aside]), np.array([-1, 0])
    two = JointPriors(np.zeros(2, bool), parent, line[:, :3], line)
    state = Articulation(line, near.state.angle * [0.5, 0.5], two.prismatic, parent)
    for priors, stay in ((two, True), (replace(two, line=None), False)):
        both = RgbEvidence(evidence.video, priors, SETTINGS)
        points = both.sample((0, 4), 60)
        start = both.label(replace(near, state=state), points)
        found = exchange_parallel_turns(both, start, both.sample((4,), 60), 3)
        assert found
        assert all(differs_in_unit_only(h, line) for h in found) == stay


def test_a_single_part_keeps_the_depths_of_bundle_adjustment() -> None:
    evidence, near, _ = door_hypothesis()
    points, dense = evidence.sample((0, 4), 60), evidence.sample((0, 4), 200)
    by_flow = evidence.label(near, points)
    assert (by_flow.points.inverse_depth != near.points.inverse_depth).any()  # not adjusted yet
    adjusted = adjust(evidence, near, VideoAdjustment((3.0, 3.0), patches=(6.0, 3)))
    depths = adjusted.points.inverse_depth
    assert np.allclose(evidence.label(adjusted, points).points.inverse_depth, depths, atol=1e-6)
    other = evidence.label(adjusted, dense).points.inverse_depth
    assert len(other) == len(dense.ray) != len(depths)
    assert depths.min() - 1e-6 <= other.min() and other.max() <= depths.max() + 1e-6


def test_depths_of_frames_without_points_are_not_made_up() -> None:
    _, near, true = door_hypothesis()
    points = replace(near.points, inverse_depth=true)
    frame = np.where(points.frame == 4, 7, 0)
    found = interpolate_depths(points, frame, points.ray, np.full(len(true), 9.0))
    assert np.allclose(found[frame == 0], true[frame == 0], atol=1e-6)
    assert (found[frame == 7] == 9.0).all()
