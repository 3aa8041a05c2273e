"""GC-Pose on boxes cast by rays: exact data give exact answers, and nothing ever raises."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.gcpose.images.flow import dis_flow
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.surfaces import (
    surface_normals,
    surfaces_from_depth,
    surfaces_from_noisy_depth,
)
from gcbench.gcpose.method import GCPose
from gcbench.renderer.types.observation import Estimate
from gcbench.robots.geometry import se3

from ..support.boxes import FRAMES, HEIGHT, INTRINSICS, WIDTH, scene, told


@pytest.mark.parametrize("kind", ["slide", "arm", "doors", "drawers"])
@pytest.mark.parametrize("knowledge", ["kinematics", "axes", "free"])
def test_exact_depth_gives_the_motion(kind: str, knowledge: str) -> None:
    observation, angle, screw, part = scene(kind)
    found = GCPose().estimate(told(observation, knowledge))
    assert found.screw is not None and found.part is not None and found.sigma is not None
    assert found.reliable is not None and found.reliable.all()
    sign = np.where(np.sum(found.screw[:, :3] * screw[:, :3], axis=1) < 0, -1, 1)
    if knowledge != "free":
        assert (sign == 1).all()
    outer = len(screw)
    off = np.abs(sign * found.displacement - angle).max()
    if kind in ("doors", "drawers") and knowledge != "kinematics":  # nothing says which is which
        swapped = np.abs(sign * found.displacement - angle[:, ::-1]).max()
        if swapped < off:
            off, outer = swapped, 1
    assert off < np.radians(0.5)
    along = np.abs(np.sum(found.screw[:, :3] * screw[:, :3], axis=1))
    assert along.min() > np.cos(np.radians(3))
    assert (found.displacement[0] == 0).all() and (found.sigma[0] == 0).all()
    assert found.part.shape == part.shape
    mine, true = found.part[0] == outer, part[0] == len(screw)
    assert (mine & true).sum() > 0.6 * (mine | true).sum()


@pytest.mark.parametrize("pace", [(0.0, 1.0), (1.0, 0.0)])
def test_a_joint_that_rests_is_reliable_only_with_axes(pace: tuple[float, float]) -> None:
    """Without axes, one motion does not tell which of two joints makes it."""
    observation, angle, _, _ = scene("arm", pace=pace)
    for knowledge in ("axes", "free"):
        found = GCPose().estimate(told(observation, knowledge))
        assert found.reliable is not None and found.reliable.all() == (knowledge == "axes")
        if knowledge == "axes":
            assert np.abs(found.displacement - angle).max() < np.radians(0.5)


def test_an_axis_given_the_other_way_round_turns_the_sign() -> None:
    observation, angle, screw, _ = scene("arm")
    rotate = replace(observation, axis_line=-screw, axis_direction=-screw[:, :3])
    assert np.abs(GCPose().estimate(rotate).displacement + angle).max() < np.radians(0.5)


@pytest.mark.parametrize("knowledge", ["kinematics", "axes"])
@pytest.mark.parametrize("kind", ["arm", "slide"])
def test_displacements_do_not_depend_on_the_camera_frame(kind: str, knowledge: str) -> None:
    """Another camera sees other pixels of the same motion: the axes move with it, nothing else."""
    new_from_old = se3.exp([0.06, -0.08, 0.3, 0.04, -0.03, 0.1])
    one, two = (GCPose().estimate(told(scene(kind, camera)[0], knowledge))
                for camera in (np.eye(4), new_from_old))
    assert np.abs(one.displacement - two.displacement).max() < np.radians(0.4)
    assert one.screw is not None and two.screw is not None
    prismatic = np.array([kind == "slide"] * len(one.screw))
    off = se3.move_screw(new_from_old, one.screw, prismatic) - two.screw
    assert np.abs(off).max() < 0.02


def test_a_turned_image_is_a_turned_camera() -> None:
    """A half turn about the optical axis keeps all pixels: only their order differs."""
    observation, _, screw, _ = scene("arm")
    assert observation.rgb is not None and observation.depth is not None
    intrinsics = INTRINSICS.copy()
    intrinsics[:2, 2] = [WIDTH - 1, HEIGHT - 1] - INTRINSICS[:2, 2]
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    turned = replace(observation, rgb=np.ascontiguousarray(observation.rgb[:, ::-1, ::-1]),
                     depth=np.ascontiguousarray(observation.depth[:, ::-1, ::-1]),
                     intrinsics=intrinsics, axis_line=se3.move_screw(half_turn, screw),
                     axis_direction=screw[:, :3] * [-1, -1, 1])
    one, two = GCPose().estimate(observation), GCPose().estimate(turned)
    assert np.abs(one.displacement - two.displacement).max() < np.radians(0.2)


@pytest.mark.parametrize("knowledge", ["kinematics", "axes"])
def test_relabeled_joints_have_relabeled_displacements(knowledge: str) -> None:
    observation = told(scene("door and drawer")[0], knowledge)
    assert observation.axis_direction is not None
    line = observation.axis_line
    swapped = replace(observation, joint_types=observation.joint_types[::-1],
                      axis_direction=observation.axis_direction[::-1],
                      axis_line=None if line is None else line[::-1])
    one, two = GCPose().estimate(observation), GCPose().estimate(swapped)
    assert np.abs(one.displacement - two.displacement[:, ::-1]).max() < np.radians(0.4)
    assert one.part is not None and two.part is not None
    relabeled = np.array([0, 2, 1])[two.part]
    assert (one.part != relabeled).mean() < 0.01


def test_the_same_input_gives_the_same_output() -> None:
    observation = told(scene("arm")[0], "axes")
    one, two = GCPose().estimate(observation), GCPose().estimate(observation)
    assert (one.displacement == two.displacement).all()


def test_one_thread_gives_what_two_give(monkeypatch: pytest.MonkeyPatch) -> None:
    observation = told(scene("arm")[0], "axes")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    two = GCPose().estimate(observation)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    one = GCPose().estimate(observation)
    assert (one.displacement == two.displacement).all()


def test_noisy_depth_gives_about_the_motion() -> None:
    observation, angle, _, _ = scene("arm")
    assert observation.depth is not None
    noise = np.random.default_rng(0).normal(0, 0.02, observation.depth.shape)
    depth = (observation.depth + noise).astype(np.float32)
    noisy = replace(observation, depth=depth, depth_noise=0.02)
    found = GCPose().estimate(noisy)
    off = np.abs(found.displacement[-1] - angle[-1]).max()
    assert off < np.radians(4.0)


@pytest.mark.parametrize("fault", ["still", "empty", "one frame", "flicker"])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_nothing_to_see_is_said(fault: str, noise: float) -> None:
    observation, _, screw, _ = scene("arm")
    assert observation.depth is not None and observation.rgb is not None
    depth, rgb, times = observation.depth, observation.rgb, observation.times
    if fault == "still":
        depth, rgb = np.repeat(depth[:1], FRAMES, 0), np.repeat(rgb[:1], FRAMES, 0)
    elif fault == "empty":
        depth = np.zeros_like(depth)
    elif fault == "one frame":
        depth, rgb, times = depth[:1], rgb[:1], times[:1]
    elif fault == "flicker":
        depth = depth * (np.random.default_rng(0).random(depth.shape) < 0.02)
    given = replace(observation, depth=depth, rgb=rgb, times=times, depth_noise=noise)
    for level in ("kinematics", "free"):
        found: Estimate = GCPose().estimate(told(given, level))
        assert found.displacement.shape == (len(times), len(screw))
        assert found.sigma is not None
        assert np.isfinite(found.displacement).all() and np.isfinite(found.sigma).all()
        if fault in ("still", "empty"):
            assert (found.displacement == 0).all() and (found.sigma[1:] >= 0.5).all()
            assert found.reliable is not None and not found.reliable.any()


def test_normals_of_a_plane_are_its_normal() -> None:
    n = np.array([0.3, -0.2, 0.9]) / np.linalg.norm([0.3, -0.2, 0.9])
    v, u = np.mgrid[:60, :80]
    ray = np.stack([u - 40, v - 30, np.full_like(u, 100)], -1) / 100.0
    depth = (1.2 / (ray @ n)).astype(np.float32)
    k = np.array([[100.0, 0, 40], [0, 100.0, 30], [0, 0, 1]])
    found = surface_normals(depth, k, ImageSettings(max_curvature=10.0))[1:-1, 1:-1]
    assert np.abs(found - n).max() < 1e-3
    rgb = np.random.default_rng(0).integers(0, 255, (2, 60, 80, 3)).astype(np.uint8)
    fitted = surfaces_from_noisy_depth(
        np.stack([depth, depth]), rgb, k, 0.5, dis_flow, ImageSettings())
    assert np.abs(fitted.normal[0, 20:40, 20:60] - n).max() < 0.03
    assert np.abs(surfaces_from_depth(depth[None], k, ImageSettings()).depth[0] - depth).max() == 0
