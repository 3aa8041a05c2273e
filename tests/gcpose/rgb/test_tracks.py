"""Tracks: flow chained from key frames goes where the flow says, and knows how well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.gcpose.chain.articulation import Articulation
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import VideoEvidence, video_evidence
from gcbench.gcpose.method import GCPose
from gcbench.gcpose.rgb.measurements import add_tracks, track_misfit
from gcbench.gcpose.rgb.points import InverseDepthPoints
from gcbench.gcpose.rgb.settings import RgbSettings
from gcbench.gcpose.rgb.tracks import chain_flow
from gcbench.gcpose.settings import Settings

from ...support.ray_scenes import door

SETTINGS = RgbSettings(track_share=0.05)
FRAMES, HEIGHT, WIDTH = 9, 60, 80
CENTER = np.array([40.0, 30.0])
PIXEL = np.array([[46.0, 33.0], [30.0, 25.0]])
KEY = np.array([4, 0])


def turn(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def turning(angle: float = 0.1, back: float = 1.0) -> VideoEvidence:
    """An image that turns about its center, rad a frame; flow back is longer by a factor."""
    at = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=2) - CENTER
    forward, backward = (np.broadcast_to(at @ (turn(a) - np.eye(2)).T,
                                         (FRAMES - 1, HEIGHT, WIDTH, 2)).astype(np.float32)
                         for a in (angle, -angle))
    texture = np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.float32)
    texture[..., [0, 2]] = 0.8
    flow_back = np.float32(back) * backward
    k = np.array([[100.0, 0, 40], [0, 100, 30], [0, 0, 1]])
    return VideoEvidence(
        (0, 0), k, np.ones((FRAMES, HEIGHT, WIDTH), bool),
        np.zeros((FRAMES, HEIGHT, WIDTH), np.float32),
        np.zeros((FRAMES, HEIGHT, WIDTH, 2), np.float32), forward.copy(),
        flow_back, texture, texture, ImageSettings())


def tracks(
    evidence: VideoEvidence, settings: RgbSettings = SETTINGS
) -> tuple[np.ndarray, np.ndarray]:
    return chain_flow(evidence, PIXEL, KEY, FRAMES, settings)


def reached(information: np.ndarray) -> np.ndarray:
    return np.trace(information, axis1=2, axis2=3) > 0


def test_a_track_goes_where_flow_goes_both_ways() -> None:
    place, information = tracks(turning())
    found = reached(information)
    gap = np.abs(np.arange(FRAMES) - KEY[:, None])
    assert (found == ((gap > 0) & (gap <= SETTINGS.track_span))).all()
    for i, t in np.argwhere(found):
        true = CENTER + turn(0.1 * (t - KEY[i])) @ (PIXEL[i] - CENTER)
        assert np.allclose(place[i, t], true, atol=1e-4)  # such flow is linear between pixels
    step = np.linalg.inv(information[0, 5])
    for t in range(6, 9):
        wide = np.linalg.inv(information[0, t])
        assert np.trace(wide) > 0.99 * (t - 4) ** 2 * np.trace(step)  # errors go together


def test_a_rim_counts_across_only_and_true_flow_more() -> None:
    seen = turning()
    rim = seen.flow_confidence.copy()
    rim[..., 2] = 0.0
    across, along = np.linalg.inv(tracks(replace(seen, flow_confidence=rim))[1][0, 5]).diagonal()
    assert along > 20 * across
    exact, plain = replace(seen, true_flow=True), replace(seen, flow_confidence=0 * rim)
    assert np.trace(tracks(exact)[1][0, 5]) > 100 * np.trace(tracks(plain)[1][0, 5])


def test_a_track_is_worth_less_and_ends_where_the_flow_back_disagrees() -> None:
    sizes = [np.trace(tracks(turning(back=back))[1][0, 5]) for back in (1.0, 1.5, 9.0)]
    assert sizes[0] > 1.2 * sizes[1] > sizes[2] == 0


def test_a_track_ends_where_the_foreground_ends() -> None:
    seen = turning()
    seen.moving[6:] = False
    found = reached(tracks(seen)[1])
    assert found[0, [2, 3, 5]].all() and not found[0, 6:].any()
    shorter = reached(tracks(turning(), replace(SETTINGS, track_span=2))[1])
    assert shorter[0].tolist() == [False, False, True, True, False, True, True, False, False]


def test_the_surer_of_patch_and_track_is_the_measurement() -> None:
    seen = turning()
    ray = np.column_stack([(PIXEL - CENTER) / 100.0, np.ones(2)])
    bare = InverseDepthPoints.without_measurements(KEY, ray, np.ones(2, np.int64), np.ones(2))
    place, information = np.zeros((2, FRAMES, 2)), np.zeros((2, FRAMES, 2, 2))
    information[0, 5] = 1e6 * np.eye(2)
    points = replace(bare, place=place, place_information=information)
    both = add_tracks(seen, points, SETTINGS)
    track = tracks(seen)
    assert np.array_equal(both.place_information[0, 5], information[0, 5])
    assert not both.place[0, 5].any()
    assert np.array_equal(both.place[0, 6], track[0][0, 6])
    assert np.array_equal(both.place_information[1], track[1][1])
    assert add_tracks(replace(seen, flow_backward=None), points, SETTINGS) is points


def test_motions_that_contradict_the_tracks_cost_more() -> None:
    """Which patches cannot tell: the image has none."""
    ray = np.column_stack([(PIXEL - CENTER) / 100.0, np.ones(2)])
    points = InverseDepthPoints.without_measurements(KEY, ray, np.ones(2, np.int64), np.ones(2))
    axis = np.array([[0.0, 0, 1, 0, 0, 0]])

    def misfit(step: float, seen: VideoEvidence) -> float:
        angle = step * np.arange(FRAMES)[:, None]
        state = Articulation(axis, angle, np.zeros(1, bool), np.array([-1]))
        return track_misfit(seen, state, points, SETTINGS)

    exact = replace(turning(), true_flow=True)
    assert misfit(0.1, exact) < 1e-3 < 0.1 < misfit(0.15, exact) < misfit(0.2, exact)
    assert misfit(0.2, turning()) < misfit(0.2, exact)
    exact.moving[:] = False
    assert misfit(0.2, exact) == misfit(0.2, replace(exact, flow_backward=None)) == 0.0


def test_flow_back_is_estimated_where_tracks_count() -> None:
    assert not GCPose("dis").front_end.bidirectional
    method = GCPose("dis", settings=Settings().override({"rgb.track_share": "0.05"}))
    observation = door(0.5)
    seen = video_evidence(observation, method.front_end, method.settings.images)
    assert seen is not None and seen.flow_backward is not None and not seen.true_flow
    still = ~(seen.moving[0] | seen.moving[1])
    there_and_back = np.abs(seen.flow[0] + seen.flow_backward[0])
    assert np.median(there_and_back[seen.moving[0]]) < 0.3 < np.abs(seen.flow[0]).max()
    assert there_and_back[still].mean() < 0.3
    true = door(0.5, true_flow=True)
    exact = video_evidence(true, GCPose("dis").front_end, method.settings.images)
    assert exact is not None and exact.true_flow and exact.flow_backward is not None
    assert (exact.flow_confidence == [1, 0, 1]).all()  # also where the image is plain
    assert np.array_equal(seen.flow_confidence, exact.texture_confidence)
    assert true.flow_backward is not None
    (left, top), (height, width) = exact.corner, exact.moving.shape[1:]
    assert np.array_equal(
        exact.flow_backward, true.flow_backward[:, top : top + height, left : left + width])


@pytest.mark.ci
def test_true_flow_gives_the_turn_of_a_door() -> None:
    errors = [np.degrees(np.abs(GCPose("dis").estimate(o).displacement[-1, 0] - 0.5))
              for o in (door(0.5, true_flow=True), door(0.5))]
    assert errors[0] < min(0.2, errors[1])
