"""Metrics by their laws: the truth is perfect, an offset is that offset, nothing is left out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from gcbench.benchmark.protocol import metrics
from gcbench.benchmark.protocol.scoring import joint_results, score_sequence
from gcbench.benchmark.protocol.truth import Truth, part_labels, truth_of
from gcbench.benchmark.results.estimates import Stored
from gcbench.benchmark.results.rows import Result, Row
from gcbench.benchmark.results.runs import Run
from gcbench.renderer.types.observation import Estimate
from gcbench.robots.geometry import revolute_motion

from ...support import analytic

PRISMATIC = np.array([False, False, True])
BLANK = Result(
    method="m", version="1", inputs="rgbd", knowledge="free", oracles="", training="none",
    dataset="d", robot="r", sequence="000000", cluster="000000", joint="", joint_index=0,
    joint_type="", frame=-1, metric="", value=0.0, unit="", sign="", status="ok",
)


@pytest.fixture
def truth() -> Truth:
    rng = np.random.default_rng(3)
    q = np.cumsum(rng.uniform(0.01, 0.1, (15, 3)) * [1, -1, 1], axis=0)
    l = rng.normal(size=(3, 3))
    l /= np.linalg.norm(l, axis=1, keepdims=True)
    point = rng.normal(size=(3, 3))
    moment = np.where(PRISMATIC[:, None], 0.0, np.cross(point, l))
    return Truth(
        joint_names=("pan", "lift", "slide"),
        joint_types=("revolute", "continuous", "prismatic"),
        prismatic=PRISMATIC, displacement=q - q[0], screw=np.hstack([l, moment]),
        origin=point, label=np.zeros(1, np.uint8), parent=(-1, 0, 1),
        pixels=np.array([900, 500, 400]))


def values(truth: Truth, estimate: Estimate | None, axes_known: bool = False) -> dict[str, list]:
    """Values by metric, in the order of the joints; errors of all frames under `error`."""
    out: dict[str, list] = {}
    for r in joint_results(truth, estimate, axes_known, BLANK):
        out.setdefault(r.metric, []).append(r.value)
    return out


def test_the_truth_is_perfect(truth: Truth) -> None:
    for axes_known in (False, True):
        got = values(truth, Estimate(truth.displacement, truth.screw), axes_known)
        for name in ("final_error", "mean_error", "step_error", "axis_direction", "axis_distance"):
            np.testing.assert_allclose(got[name], 0, atol=1e-6, err_msg=name)
        assert got["covered"] == [1, 1, 1]
        assert len(got["error"]) == 3 * 14


@pytest.mark.parametrize("flip", [[-1, 1, 1], [1, -1, -1], [-1, -1, -1]])
def test_at_free_a_flipped_axis_with_its_sign_is_the_same(truth: Truth, flip: list[int]) -> None:
    sign = np.array(flip, float)
    got = values(truth, Estimate(sign * truth.displacement, sign[:, None] * truth.screw))
    np.testing.assert_allclose(got["final_error"], 0, atol=1e-9)
    np.testing.assert_allclose(got["axis_direction"], 0, atol=1e-6)
    # The sign without its axis is wrong, and without any axis it is a gauge.
    wrong = values(truth, Estimate(sign * truth.displacement, truth.screw))["final_error"]
    assert (np.array(wrong)[sign < 0] > 0.05).all()
    results = joint_results(truth, Estimate(sign * truth.displacement), False, BLANK)
    finals = [r for r in results if r.metric == "final_error"]
    np.testing.assert_allclose([r.value for r in finals], 0, atol=1e-9)
    assert {r.sign for r in finals} == {"best"}


def test_with_known_axes_the_sign_is_theirs(truth: Truth) -> None:
    results = joint_results(truth, Estimate(-truth.displacement, -truth.screw), True, BLANK)
    finals = [r for r in results if r.metric == "final_error"]
    expected = 2 * np.abs(truth.displacement[-1]) * [np.degrees(1), np.degrees(1), 1]
    np.testing.assert_allclose([r.value for r in finals], expected)
    assert {r.sign for r in finals} == {"given"}


def test_a_known_offset_scores_that_offset(truth: Truth) -> None:
    offset = np.array([0.02, -0.03, 0.05])
    got = values(truth, Estimate(truth.displacement + offset), axes_known=True)
    np.testing.assert_allclose(got["final_error"], [np.degrees(0.02), np.degrees(0.03), 0.05])
    np.testing.assert_allclose(got["mean_error"], got["final_error"])
    np.testing.assert_allclose(got["step_error"], 0, atol=1e-9)


def test_angles_wrap_and_slides_do_not(truth: Truth) -> None:
    got = values(truth, Estimate(truth.displacement + 2 * np.pi), axes_known=True)
    np.testing.assert_allclose(got["final_error"], [0, 0, 2 * np.pi], atol=1e-9)
    assert metrics.wrap(np.array([np.pi - 0.1 + 0.2]))[0] == pytest.approx(-np.pi + 0.1)


def test_holding_still_scores_the_displacement(truth: Truth) -> None:
    got = values(truth, Estimate(np.zeros_like(truth.displacement)))
    assert got["final_error"] == got["displacement"]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_what_is_not_finite_counts_as_no_motion(truth: Truth, bad: float) -> None:
    broken = truth.displacement.copy()
    broken[4, 1] = bad  # one frame spoils the joint, and only that joint
    got = values(truth, Estimate(broken), axes_known=True)
    assert got["covered"] == [1, 0, 1]
    assert got["final_error"][1] == got["displacement"][1]
    assert got["final_error"][0] == got["final_error"][2] == 0
    nothing = values(truth, None)
    assert nothing["covered"] == [0, 0, 0]
    assert nothing["final_error"] == nothing["displacement"]


def test_axis_errors_are_those_that_were_made(truth: Truth) -> None:
    l, m = truth.screw[:, :3], truth.screw[:, 3:]
    across = np.cross(l, [0.3, 0.5, 0.7])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    shifted = np.hstack([l, m + np.cross(0.04 * across, l)])
    np.testing.assert_allclose(metrics.axis_distance(shifted, truth.screw, truth.origin)[:2], 0.04)
    assert np.allclose(metrics.axis_direction_error(shifted, truth.screw), 0)
    # Tilted by 0.2 rad about the joint itself: the distance stays zero. Any length will do.
    joint = truth.origin
    tilted = np.cos(0.2) * l + np.sin(0.2) * across
    screw = 3.0 * np.hstack([tilted, np.cross(joint, tilted)])
    np.testing.assert_allclose(metrics.axis_direction_error(screw, truth.screw), 0.2)
    np.testing.assert_allclose(metrics.axis_distance(screw, truth.screw, joint)[:2], 0, atol=1e-9)


def test_directions_are_not_clamped_away_by_rounding() -> None:
    """ScrewNet's evaluator takes acos of a dot product that may be 1.0000000000000002: NaN."""
    rng = np.random.default_rng(0)
    l = rng.normal(size=(5000, 3))
    l /= np.linalg.norm(l, axis=1, keepdims=True)
    screw = np.hstack([l, 0 * l])
    assert ((l * l).sum(1) > 1).any()
    angle = metrics.axis_direction_error(screw, screw)
    assert np.isfinite(angle).all()
    assert angle.max() < 1e-7
    opposed = metrics.axis_direction_error(-screw, screw)
    assert opposed.max() < 1e-7


def test_an_axis_that_is_none_is_not_given(truth: Truth) -> None:
    for bad in (np.nan, np.inf, 0.0):
        screw = truth.screw.copy()
        screw[1] = bad
        results = joint_results(truth, Estimate(-truth.displacement, screw), False, BLANK)
        signs = [r.sign for r in results if r.metric == "final_error"]
        assert signs == ["screw", "best", "screw"]
        assert {r.joint for r in results if r.metric == "axis_direction"} == {"pan", "slide"}


def test_sigma_is_calibrated_if_two_thirds_are_within(truth: Truth) -> None:
    sigma = np.full_like(truth.displacement, 0.025)
    offset = np.array([0.02, 0.03, 0.02])
    got = values(truth, Estimate(truth.displacement + offset, sigma=sigma), axes_known=True)
    assert got["within_sigma"] == [1, 0, 1]
    assert got["within_sigma_frames"] == [1, 0, 1]
    np.testing.assert_allclose(got["sigma"], [np.degrees(0.025), np.degrees(0.025), 0.025])
    sigma[:, 0], sigma[:, 1], sigma[:, 2] = np.nan, -1, np.inf
    got = values(truth, Estimate(truth.displacement + offset, sigma=sigma), axes_known=True)
    assert got["within_sigma"] == [1]  # only infinity is a standard deviation


def test_a_joint_is_reliable_if_the_method_says_so_and_estimates_it(truth: Truth) -> None:
    moved, reliable = truth.displacement.copy(), np.array([True, False, True])
    assert values(truth, Estimate(moved, reliable=reliable))["reliable"] == [1, 0, 1]
    moved[1, 2] = np.nan
    assert values(truth, Estimate(moved, reliable=reliable))["reliable"] == [1, 0, 0]
    assert "reliable" not in values(truth, Estimate(moved))


def test_iou_counts_pixels() -> None:
    truth = np.array([[0, 1, 1, 2]], np.uint8)
    found = np.array([[1, 1, 0, 2]], np.uint8)
    same, union = metrics.part_iou(found, truth, 3)
    assert same.tolist() == [1, 1, 0]
    assert union.tolist() == [3, 1, 0]
    assert metrics.mean_iou(same, union) == pytest.approx((1 / 3 + 1) / 2)


def test_parts_go_to_the_last_scored_joint_that_moves_them() -> None:
    sequence = analytic.render(width=48, height=36, frames=4, room=False)
    truth = truth_of(sequence)
    # base, turret (pan), upper (lift), post (slide, which is not scored but moves here), hand
    assert truth.joint_names == ("pan", "lift")
    assert truth.label[:4].tolist() == [0, 0, 1, 2]
    np.testing.assert_allclose(truth.displacement[-1], [0.3, -0.24])
    still = dataclasses.replace(
        sequence.state, world_from_part=np.stack([sequence.state.world_from_part[0]] * 4))
    assert part_labels(still, np.array([2, 3]))[[2, 3]].tolist() == [1, 2]


def test_pixels_and_distance_are_those_of_the_images() -> None:
    sequence = analytic.render(width=48, height=36, frames=4, room=False)
    pixels = [[sum((part == p).sum() for p, label in enumerate(truth_of(sequence).label)
                   if label >= j) for part in sequence.part] for j in (1, 2)]
    results = joint_results(truth_of(sequence), None, True, BLANK)
    found = {name: [r.value for r in results if r.metric == name] for name in
             ("pixels", "distance")}
    assert found["pixels"] == np.min(pixels, axis=1).tolist()
    state = sequence.state
    world = [state.world_from_part[0, p - 1] for p in state.joint_child_part[:2]]
    there = [(state.cam_from_world[0] @ pose)[:3, 3] for pose in world]
    assert found["distance"] == pytest.approx(np.linalg.norm(there, axis=1))


def test_labels_do_not_depend_on_where_the_base_is() -> None:
    sequence = analytic.render(width=48, height=36, frames=4, room=False)
    state = sequence.state
    moved = revolute_motion([0, 0, 1, 3, 2, 0], 0.7) @ state.world_from_part
    label = part_labels(dataclasses.replace(state, world_from_part=moved), np.array([2, 3]))
    assert label.tolist() == truth_of(sequence).label.tolist()


def test_a_sequence_scores_its_own_truth() -> None:
    sequence = analytic.render(width=48, height=36, frames=4, room=False)
    truth = truth_of(sequence)
    part = np.stack([truth.label[p] for p in sequence.part])
    row = Row("oracle", "1", "rgbd", "free", "none")
    run = Run(row, "", "d", "", {"robot": "arm"}, (), ("000000",), 0, {}, ())
    estimate = Estimate(-truth.displacement, -truth.screw, part, 0 * truth.displacement)
    results = score_sequence(sequence, Stored("ok", "", 2.0, 10.0, estimate), run, "000000")
    by = {r.metric: r for r in results if not r.joint}
    assert by["part_miou"].value == 1
    assert by["seconds_per_frame"].value == 0.5
    assert {r.value for r in results if r.metric == "final_error"} == {0.0}
    failed = score_sequence(sequence, Stored("crashed", "why"), run, "000000")
    assert {r.status for r in failed} == {"crashed"}
    assert [r.value for r in failed if r.metric == "covered"] == [0, 0]
    assert not [r for r in failed if r.metric in ("seconds", "part_miou")]
