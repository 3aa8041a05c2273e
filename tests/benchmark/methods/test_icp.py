"""ICP on exact points gives the exact motion; what shape cannot tell it leaves alone."""

from __future__ import annotations

import numpy as np
import pytest
from gcbench import MethodError
from gcbench.benchmark.methods import icp
from gcbench.benchmark.methods.icp import Icp, IcpFirst, LabelledDepth
from gcbench.benchmark.methods.registry import load_method
from gcbench.benchmark.protocol.observations import observe
from gcbench.benchmark.protocol.truth import truth_of
from gcbench.robots.geometry import Array, apply, revolute_motion, rotation_about, se3, transform

from ...support import analytic

K = np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]])


def points(n: int = 300) -> Array:
    return np.random.default_rng(0).uniform([-0.3, -0.2, 1.0], [0.3, 0.2, 1.4], (n, 3))


def motion() -> Array:
    return transform(rotation_about([0.6, 0, 0.8], 0.07), [0.01, -0.02, 0.03])


def test_kabsch_is_exact_and_never_mirrors() -> None:
    p = points()
    np.testing.assert_allclose(icp.kabsch(p, apply(motion(), p)), motion(), atol=1e-12)
    flat = p * [1, 1, 0]  # of a plane the least squares could mirror
    assert np.linalg.det(icp.kabsch(flat, apply(motion(), flat))[:3, :3]) == pytest.approx(1)


def test_robust_kabsch_ignores_a_third_that_is_wrong() -> None:
    p, rng = points(), np.random.default_rng(1)
    q = apply(motion(), p)
    q[::3] += rng.uniform(0.05, 0.3, (100, 3))
    np.testing.assert_allclose(icp.robust_kabsch(p, q), motion(), atol=1e-6)


def test_correspondences_are_those_of_flow_and_depth() -> None:
    u = np.mgrid[:240, :320][1].astype(float)
    depth = (1.2 + 0.001 * u).astype(np.float32)
    part = np.zeros((240, 320), np.uint8)
    part[60:180, 80:240] = 1
    part[60:180, 239] = 2
    flow = np.zeros((240, 320, 2), np.float32)
    flow[..., 0], flow[100, 100] = 2.0, np.nan
    there = depth.copy()
    there[70, :] = 0  # no depth
    there[80, :] += 0.11  # too far
    here, next_frame = LabelledDepth(depth, part, K), LabelledDepth(there, part, K)
    source, target = icp.correspondences(here, next_frame, flow, 1)
    # 159 columns of which the last two end in another part; two rows are left out; one is NaN.
    assert len(source) == len(target) == 118 * 157 - 1
    assert np.abs((target - source)[:, 1]).max() < 0.01
    np.testing.assert_allclose(
        (target @ K.T / target[:, 2:])[:, 0] - (source @ K.T / source[:, 2:])[:, 0], 2, atol=1e-9)
    nothing = icp.correspondences(here, next_frame, flow * np.nan, 1)
    assert len(nothing[0]) == 0


def corner() -> tuple[Array, Array]:
    """Points and normals of three faces of a box: every motion shows."""
    a, b = (x.ravel() for x in np.mgrid[0:0.3:31j, 0:0.3:31j])
    zero = np.zeros_like(a)
    faces = np.vstack([np.stack(f, 1) for f in ((a, b, zero), (a, zero, b), (zero, a, b))])
    normals = np.repeat(np.eye(3)[[2, 1, 0]], len(a), axis=0)
    return faces + np.array([0, 0, 1.0]), normals


def test_icp_finds_what_the_shape_tells() -> None:
    target, normal = corner()
    true = transform(rotation_about([0.6, 0, 0.8], 0.02), [0.004, -0.003, 0.002])
    source = apply(np.linalg.inv(true), target)
    pose, pairs = icp.align_surfaces(source, target, normal, np.eye(4))
    np.testing.assert_allclose(pose, true, atol=1e-4)
    assert pairs is not None


def test_icp_leaves_what_the_shape_does_not_tell() -> None:
    """A cylinder's turn about its own axis stays as flow said."""
    angle, height = (x.ravel() for x in np.mgrid[-1:1:60j, 0:0.4:40j])
    normal = np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], 1)
    target = 0.1 * normal + np.stack([0 * angle, height, 0 * angle + 1.5], 1)
    axis = [0, 1, 0, *np.cross([0, 0, 1.5], [0, 1, 0])]
    start = revolute_motion(axis, 0.05)
    pose, pairs = icp.align_surfaces(target, target, normal, start)
    assert se3.so3_log(pose[:3, :3])[1] == pytest.approx(0.05, abs=0.003)
    assert pairs is not None
    information = icp.rotation_information(*pairs, 0.001, 100.0)
    assert information[1, 1] < 1e-3 * min(information[0, 0], information[2, 2])


def test_slides_side_by_side_do_not_carry_each_other() -> None:
    slid = np.stack([np.eye(4)[None].repeat(3, axis=0),
                     [np.eye(4), transform(None, [0.1, 0, 0]), transform(None, [0.2, 0, 0])]])
    along, beside = np.array([[1.0, 0, 0]] * 2), np.array([-1, -1])
    np.testing.assert_allclose(
        icp.displacements(slid, along, beside, np.zeros((2, 3)))[1], [0.1, 0.2])


def test_a_slide_is_relative_to_the_part_before_it() -> None:
    axes = np.array([[0, 0, 1.0], [1, 0, 0]])
    turn = revolute_motion([0, 0, 1, 0.5, -0.2, 0], 0.4)
    motion = np.stack([[np.eye(4)] * 3, [np.eye(4), turn, turn @ transform(None, [0.07, 0, 0])]])
    origin = np.array([[0, 0, 0.0], [0.3, 0.2, 1]])
    moved = icp.displacements(motion, axes, np.array([-1, 0]), origin)
    np.testing.assert_allclose(moved[1, 1], 0.07)


@pytest.mark.parametrize("method", [Icp(), IcpFirst()])
def test_a_whole_sequence(method: Icp) -> None:
    """True flow, true depth, true parts: a fraction of a degree at this size of image."""
    sequence = analytic.render(width=320, height=240, frames=4, room=False)
    observation = observe(sequence, "rgbd", "axes", ("true-parts", "true-flow"))
    estimate = method.estimate(observation)
    error = np.degrees(np.abs(estimate.displacement - truth_of(sequence).displacement))
    assert error[0].max() == 0
    assert error.max() < 1.0


def test_parts_come_from_the_segmenter_where_they_are_not_given() -> None:
    sequence = analytic.render(width=160, height=120, frames=3, room=False)
    given = observe(sequence, "rgbd", "axes", ("true-parts", "true-flow"))
    blind = observe(sequence, "rgbd", "axes", ("true-flow",))
    for segment in (None, lambda observation: None):
        with pytest.raises(MethodError, match="needs the parts, and found none"):
            Icp(segment=segment).estimate(blind)
    found = Icp(segment=lambda observation: given.part).estimate(blind)
    np.testing.assert_array_equal(found.displacement, Icp().estimate(given).displacement)
    with pytest.raises(MethodError, match="needs the directions of the axes"):
        Icp().estimate(observe(sequence, "rgbd", "free"))
    assert load_method("icp").segment is not None  # type: ignore[attr-defined]  # of another method, by the registry
