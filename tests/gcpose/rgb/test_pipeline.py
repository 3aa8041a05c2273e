"""GC-Pose without depth, from images to angles: what moves, and which solution is chosen."""

from __future__ import annotations

from dataclasses import replace
from threading import Barrier
from typing import Any

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.benchmark.methods.registry import load_method, with_options
from gcbench.errors import MethodError
from gcbench.gcpose.chain.articulation import Articulation
from gcbench.gcpose.chain.priors import JointPriors, joint_priors, scale_axes
from gcbench.gcpose.estimator import BundleEquations
from gcbench.gcpose.images.flow import Flow, dis_flow
from gcbench.gcpose.images.foreground import subtract_background
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import FrontEnd, VideoEvidence, video_evidence
from gcbench.gcpose.method import GCPose
from gcbench.gcpose.numerics.threads import thread_map
from gcbench.gcpose.rgb.costs import flow_records
from gcbench.gcpose.rgb.evidence import RgbEvidence, VideoHypothesis
from gcbench.gcpose.rgb.labels import SampledPixels, sample_pixels
from gcbench.gcpose.rgb.pipeline import base_from_world, object_distance, settings_of_video
from gcbench.gcpose.rgb.points import InverseDepthPoints
from gcbench.gcpose.rgb.scores import score_hypothesis, select_hypotheses
from gcbench.gcpose.rgb.search import count_agreeing, search_video
from gcbench.gcpose.rgb.settings import RgbSettings, for_one_joint
from gcbench.gcpose.settings import Settings
from gcbench.renderer.types.observation import Observation

from ...support.ray_scenes import chain, door, texture, with_passing_shadow

SETTINGS = RgbSettings()


def by_color(rgb: np.ndarray) -> np.ndarray:
    return subtract_background(rgb, ImageSettings())


def evidence_of(observation: Observation, flow: Flow = dis_flow) -> VideoEvidence:
    found = video_evidence(observation, FrontEnd(flow, by_color), ImageSettings())
    assert found is not None
    return found


def hypothesis(
    state: Articulation, points: InverseDepthPoints, base: np.ndarray, matrix: np.ndarray,
    penalty: float = 0.0,
) -> VideoHypothesis:
    return VideoHypothesis(state, points, base, 3.0, equations(matrix), penalty)


def equations(matrix: np.ndarray) -> BundleEquations:
    return BundleEquations(matrix, np.zeros(len(matrix)))


def score(found: VideoHypothesis) -> float:
    return score_hypothesis(found, SETTINGS)


def test_the_foreground_is_what_moves() -> None:
    rng = np.random.default_rng(2)
    wall, box = texture(rng, 100, 120), texture(rng, 30, 30)
    video = np.repeat(wall[None], 6, axis=0)
    truth = np.zeros(video.shape[:3], bool)
    for t in range(6):
        video[t, 30:60, 10 + 14 * t : 40 + 14 * t] = box
        truth[t, 30:60, 10 + 14 * t : 40 + 14 * t] = True
    found = by_color(video)
    assert np.mean(found != truth) < 0.003
    assert not by_color(np.repeat(wall[None], 4, axis=0)).any()


def test_a_flow_of_cuts_is_told_how_large_the_images_are() -> None:
    observation, told = door(0.3), list[tuple[int, int]]()

    class Sized:
        def for_cuts_of(self, height: int, width: int) -> Flow:
            told.append((height, width))
            return dis_flow

        def __call__(self, rgb_a: np.ndarray, rgb_b: np.ndarray) -> np.ndarray:
            raise AssertionError("seen at another scale")

    seen = evidence_of(observation, Sized())
    assert told == [(180, 240)]
    assert seen.flow.shape[1:3] < (180, 240)


def test_a_door_opens_without_depth() -> None:
    observation = door(0.5)
    estimate = GCPose("dis").estimate(observation)
    assert estimate.part is not None
    assert estimate.part.shape == (8, 180, 240)
    assert np.degrees(np.abs(estimate.displacement[:, 0] - 0.5 * np.linspace(0, 1, 8)).max()) < 2.0
    assert estimate.sigma is not None and estimate.reliable is not None
    assert estimate.sigma[0] == 0 and estimate.reliable.all()


@pytest.mark.parametrize(("most", "covered", "kind"), [
    (0.2, 0.2, "revolute"), (0.2, 0.2, "continuous"), (1.0, 0.5, "revolute")])
def test_a_shadow_that_passes_does_not_stop_a_door(
    most: float, covered: float, kind: str
) -> None:
    """Still texture is left out; without that, half of the foreground is at rest."""
    observation = door(0.5)
    assert observation.rgb is not None
    observation = replace(observation, rgb=with_passing_shadow(observation.rgb),
                          joint_types=(kind,))
    settings = Settings(images=replace(ImageSettings(), max_still_texture=most))
    method = GCPose("dis", settings=settings)
    found = method.estimate(observation)
    assert found.part is not None
    assert np.mean(found.part > 0) == pytest.approx(covered, abs=0.1)
    assert np.degrees(abs(found.displacement[-1, 0] - 0.5)) < 2.0
    assert found.reliable is not None and found.reliable[0] == (most == 1.0)
    assert method.finds_shadows(observation) == (most == 0.2)


@pytest.mark.ci
def test_each_flow_has_its_search() -> None:
    observation = door(0.5)
    video, priors = evidence_of(observation), joint_priors(observation)
    one = search_video(RgbEvidence(video, priors, SETTINGS))
    two = search_video(RgbEvidence(replace(video, second=video), priors, SETTINGS))
    assert one is not None and two is not None
    # the best one is no alternative
    assert len(two.others) + 1 == 2 * (len(one.others) + 1)
    np.testing.assert_allclose(two.best.state.angle, one.best.state.angle, atol=1e-3)
    assert not (one.alone or two.alone)


def test_deviations_are_larger_where_nothing_is_known_of_several_axes() -> None:
    video = evidence_of(door(0.5))
    for joints, direction, larger in ((1, None, False), (2, None, True), (2, np.eye(3)[:2], False)):
        known = JointPriors(np.zeros(joints, bool), np.arange(joints) - 1, direction, None)
        deviation = settings_of_video(video, known, SETTINGS).deviation
        assert (deviation.factor > SETTINGS.deviation.factor) == larger
        assert (deviation.floor > SETTINGS.deviation.floor) == larger


def test_a_video_that_is_too_large_is_an_error() -> None:
    seen = evidence_of(door(0.5))
    large = np.broadcast_to(np.ones(1, bool), (1200, 480, 640))
    with pytest.raises(MethodError, match=r"369 million pixels .* smaller images"):
        flow_records(replace(seen, moving=large))


def test_searches_agree_on_motions_that_are_alike() -> None:
    motion = np.array([[0.1, 0.5], [0.3, 0.5], [0.11, 0.49], [0.1, 0.5], [0.1, 0.9], [0.12, 0.5]])
    search = np.array([0, 0, 1, 1, 1, 2])
    assert (count_agreeing(motion, search, 0.03) == [2, 0, 2, 2, 0, 2]).all()
    assert (count_agreeing(motion, search, 0.015) == [1, 0, 2, 1, 0, 1]).all()
    assert not count_agreeing(motion, 0 * search, 1.0).any()


def test_a_true_mask_replaces_the_foreground() -> None:
    observation = door(0.5)
    mask = np.zeros((8, 180, 240), bool)
    mask[:, 40:90, 100:140] = True
    seen = video_evidence(
        replace(observation, mask=mask), FrontEnd(dis_flow, by_color), ImageSettings())
    assert seen is not None and seen.part is None
    left, top = seen.corner
    assert seen.moving.sum() == mask.sum()
    assert seen.moving[0, 40 - top : 90 - top, 100 - left : 140 - left].all()


def test_a_machine_of_several_joints_stands_at_the_origin_of_the_world() -> None:
    observation = replace(door(0.5), joint_types=("revolute",) * 2, n_joints=2)
    seen = evidence_of(observation)

    def base(*at: float, of: Observation = observation) -> np.ndarray | None:
        world = np.eye(4)
        world[:3, 3] = at
        return base_from_world(replace(of, cam_from_world=world), seen)

    near = base(0.1, 0.3, 2.0)
    assert near is not None
    assert np.allclose(near, [0.05, 0.15, 1.0])
    assert base(0.1, 0.3, -2.0) is None  # behind the camera
    assert base(3.0, 0.3, 2.0) is None  # too far away for what moves
    assert base(0.1, 0.3, 2.0, of=door(0.5)) is None  # a door is not hinged at its middle
    assert base(0.1, 0.3, 2.0, of=replace(observation, joint_parent=(-1, -1))) is None
    known = base(0.1, 0.3, 2.0, of=replace(observation, axis_line=np.zeros((2, 6))))
    assert known is not None and np.array_equal(known, near)
    assert base_from_world(replace(observation, cam_from_world=None), seen) is None


def test_of_two_that_explain_as_much_the_surer_is_chosen() -> None:
    state, at = chain()
    empty = np.zeros(0)
    none = np.zeros(0, np.int64)
    rays = InverseDepthPoints.without_measurements(none, np.zeros((0, 3)), none, empty)
    held = state.angle[1:].size
    matrix = 4.0 * np.eye(held + 6)
    sure = hypothesis(state, rays, at[0], matrix, penalty=0.4)
    weaker = np.diag(np.tile([4.0, 0.04, 4.0], held // 3 + 2))
    unsure = replace(sure, equations=equations(weaker))
    assert np.allclose(sure.deviation(), 0.5)
    assert np.allclose(unsure.deviation()[:, 1], 5.0, rtol=1e-3)
    assert score(sure) < score(unsure) < score(replace(sure, cost=3.3))
    assert score(replace(sure, penalty=0.5)) > score(sure)
    surest = replace(sure, equations=equations(1e6 * matrix))
    assert score(surest) < score(sure)
    assert score(surest) == score(replace(sure, equations=equations(1e8 * matrix)))


def test_axes_should_pass_where_their_parts_begin() -> None:
    observation = door(0.5)
    seen = evidence_of(observation)
    state, at = chain()
    end = np.array([0.05, -0.12, 0.95])
    point = np.concatenate([np.linspace(a, b, 30)
                            for a, b in zip(at, [*at[1:], end], strict=True)])
    rays = InverseDepthPoints.without_measurements(
        np.zeros(90, np.int64), point / point[:, 2:], np.repeat([1, 2, 3], 30), 1 / point[:, 2])
    start = hypothesis(state, rays, at[0], np.eye(1))
    evidence = RgbEvidence(
        seen, JointPriors(state.prismatic, state.parent, state.twist[:, :3], None), SETTINGS)
    assert evidence.axis_offset(start) < 0.02

    def moved(joint: int) -> VideoHypothesis:
        line = state.twist[joint, :3]
        away = 0.2 * np.cross(line, [0, 0, 1.0]) / np.linalg.norm(np.cross(line, [0, 0, 1.0]))
        twist = state.twist.copy()
        twist[joint, 3:] += np.cross(away, line)
        return replace(start, state=replace(state, twist=twist))

    assert 0.4 < evidence.axis_offset(moved(2)) < 0.6
    assert evidence.axis_offset(moved(0)) == evidence.axis_offset(start)  # the base is unseen


def test_the_best_that_differ_are_those_of_the_measure_that_is_asked_for() -> None:
    state, at = chain()
    rays = InverseDepthPoints.without_measurements(
        np.zeros(1, np.int64), np.ones((1, 3)), np.ones(1, np.int64), np.ones(1))
    first = hypothesis(state, rays, at[0], np.eye(1), penalty=2.0)
    alike = replace(first, cost=4.0, penalty=1.0)
    other = replace(first, cost=5.0, state=replace(state, angle=2 * state.angle), penalty=1.5)
    assert select_hypotheses([other, alike, first], 9, SETTINGS) == [first, other]
    found = select_hypotheses([other, alike, first], 9, SETTINGS, key=lambda g: g.penalty)
    assert found == [alike, other]
    assert select_hypotheses([other, alike, first], 1, SETTINGS) == [first]
    labels = np.full(1, 2)
    unlike = replace(first, cost=3.5, points=replace(rays, label=labels))
    assert select_hypotheses([other, unlike, first], 9, SETTINGS) == [first, unlike, other]
    assert select_hypotheses([other, unlike, first], 9, SETTINGS, labels=1.0) == [first, other]


def test_a_door_that_turns_little_and_its_mirror_image_differ() -> None:
    state, at = chain()
    rays = InverseDepthPoints.without_measurements(
        np.zeros(1, np.int64), np.ones((1, 3)), np.ones(1, np.int64), np.ones(1))
    by_turn = {turn: hypothesis(replace(state, angle=np.full((8, 3), turn)), rays, at[0], np.eye(1))
               for turn in (0.04, 0.08, -0.04)}
    found = list(by_turn.values())
    assert select_hypotheses(found, 9, SETTINGS) == found[:1]
    door_settings = for_one_joint(SETTINGS, slides=False)
    assert select_hypotheses(found, 9, door_settings) == [by_turn[0.04], by_turn[-0.04]]
    assert select_hypotheses(found, 9, for_one_joint(SETTINGS, slides=True)) == found[:1]


@pytest.mark.ci
def test_known_axes_give_the_unit_of_length() -> None:
    """Axes that are all farther away by a factor: the same turns, and slides by that factor."""
    observation = door(0.5)
    assert observation.axis_direction is not None
    turn = np.concatenate([observation.axis_direction,
                           np.cross([[-0.15, 0.0, 1.2]], observation.axis_direction)], axis=1)
    known = JointPriors(np.array([False, True]), np.arange(-1, 1), np.eye(3)[:2],
                  np.concatenate([turn, [[0, 0, 0, 1.0, 0, 0]]]))
    evidence = evidence_of(observation)
    near, far = (object_distance(scale_axes(known, by), evidence) for by in (1.0, 4.0))
    assert np.isclose(far, 4.0 * near)
    farther = scale_axes(known, 4.0)
    assert np.array_equal(farther.line[1], known.line[1])  # a slide's direction has no unit
    assert np.allclose(scale_axes(farther, 1 / far).line, scale_axes(known, 1 / near).line)
    angle, distant = (
        GCPose("dis").estimate(replace(observation, axis_line=scale_axes(
            replace(known, line=turn, prismatic=known.prismatic[:1]), by).line)).displacement
        for by in (1.0, 4.0))
    assert np.degrees(np.abs(angle[:, 0] - 0.5 * np.linspace(0, 1, 8)).max()) < 2.0
    assert np.allclose(angle, distant, atol=np.radians(0.1))


def test_nothing_moves_and_nothing_breaks() -> None:
    still = replace(door(0.0), axis_direction=None, cam_from_world=None)
    estimate = GCPose().estimate(still)
    assert not estimate.displacement.any()
    assert estimate.sigma is not None and estimate.reliable is not None
    assert (estimate.sigma[1:] > 0.5).all() and not estimate.reliable.any()


def test_a_slide_has_no_length_without_depth() -> None:
    estimate = GCPose().estimate(replace(door(0.3), joint_types=("prismatic",)))
    assert estimate.sigma is not None and estimate.reliable is not None
    assert (estimate.sigma[1:] == SETTINGS.sigma_unknown).all() and not estimate.reliable.any()


def test_pixels_that_are_not_square_are_refused() -> None:
    observation = door(0.5)
    oblong = observation.intrinsics * np.array([[1.0], [1.2], [1.0]])
    with pytest.raises(GcbenchError, match="square pixels"):
        GCPose("dis").estimate(replace(observation, intrinsics=oblong))


def test_sampled_pixels_stay_on_what_moves() -> None:
    observation = door(0.5)
    seen = evidence_of(observation)
    found = sample_pixels(seen, (0, 4), 60, SETTINGS)
    assert seen.moving[found.frame, found.pixel[:, 1], found.pixel[:, 0]].all()
    assert set(found.frame) == {0, 4}


def test_two_threads_sample_the_same_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hypotheses on the same pixels are told by identity: a second sample changed the estimate."""
    one = JointPriors(np.zeros(1, bool), np.array([-1]), np.array([[0.0, 1.0, 0.0]]), None)
    evidence = RgbEvidence(evidence_of(door(0.5)), one, SETTINGS)
    together = Barrier(2, timeout=60.0)

    def sample(*arguments: Any) -> SampledPixels:
        together.wait()
        return sample_pixels(*arguments)

    monkeypatch.setattr("gcbench.gcpose.rgb.evidence.sample_pixels", sample)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    first, second = thread_map(lambda _: evidence.sample((0, 3), 50), range(2))
    assert first is second is evidence.sample((0, 3), 50)


def test_options_make_another_row() -> None:
    source = "gcbench.gcpose.method:GCPose"
    method = load_method(source)
    assert (method.name, method.training) == (
        "gcpose", "supervised: masks of synthetic video, for rgb and rgbd-noise; "
        "supervised: flow of synthetic video, for rgb")
    without = load_method(with_options(source, {"foreground": "background", "flow": "dis"}))
    assert (without.name, without.training) == ("gcpose flow=dis foreground=background", "none")
    assert load_method(with_options(source, {"flow": "dis"})).name == "gcpose flow=dis"
    with pytest.raises(GcbenchError, match="no flow 'magic'"):
        load_method(with_options(source, {"flow": "magic"}))
    with pytest.raises(GcbenchError, match="has no option --flow"):
        load_method(with_options("gcbench.benchmark.methods.baselines:HoldStill", {"flow": "dis"}))
