"""GC-Pose on boxes cast by rays: exact data give exact answers, and nothing ever raises."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from gcbench.gcpose.chain.articulation import Articulation, Hypothesis
from gcbench.gcpose.chain.beam import spread_places
from gcbench.gcpose.chain.hinges import locate_hinges
from gcbench.gcpose.chain.kinematics import part_motions, twists_of
from gcbench.gcpose.chain.priors import joint_priors
from gcbench.gcpose.chain.settings import ChainSettings
from gcbench.gcpose.images.flow import dis_flow
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.surfaces import (
    surface_normals,
    surfaces_from_depth,
    surfaces_from_noisy_depth,
)
from gcbench.gcpose.method import GCPose
from gcbench.gcpose.numerics.threads import thread_map
from gcbench.gcpose.rgbd.depth_sweep import DepthStepCosts, sweep_depth
from gcbench.gcpose.rgbd.kernels import columns
from gcbench.gcpose.rgbd.labels import moving_mask
from gcbench.gcpose.rgbd.search import motion_difference, select_by_motion
from gcbench.gcpose.rgbd.settings import LabelSettings, RgbdSettings
from gcbench.gcpose.rgbd.tracker import Tracker
from gcbench.renderer.types.observation import Estimate, Observation
from gcbench.robots.geometry import inverse, rotation_from_rpy, se3

STILL = np.eye(4)
HEIGHT, WIDTH, FRAMES = 180, 240, 8
INTRINSICS = np.array([[260.0, 0, 119.5], [0, 260.0, 89.5], [0, 0, 1]])
TILT = rotation_from_rpy([0.45, -0.6, 0.0])


Box = tuple[int, list[float], list[float]]


def cast(
    motion: np.ndarray, boxes: list[Box], world: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and part [T H W] of boxes (part, center, half size) before a wall at 3 m."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    ray = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(INTRINSICS).T
    depth = np.full((len(motion), HEIGHT, WIDTH), 3.0)
    part = np.zeros(depth.shape, int)
    for t in range(len(motion)):
        for j, center, half in boxes:
            box_from_cam = inverse(motion[t, j] @ world)
            o = box_from_cam[:3, 3] - np.array(center)
            d = ray @ box_from_cam[:3, :3].T
            with np.errstate(divide="ignore", invalid="ignore"):
                one, two = (-np.array(half) - o) / d, (np.array(half) - o) / d
            near, far = np.minimum(one, two).max(-1), np.maximum(one, two).min(-1)
            hit = (near < far) & (near > 0.1) & (near < depth[t])
            depth[t][hit], part[t][hit] = near[hit], j
    return np.round(depth, 4).astype(np.float32), part


Scene = tuple[Observation, np.ndarray, np.ndarray, np.ndarray]


def scene(kind: str, new_from_old: np.ndarray = STILL) -> Scene:
    """An observation with known lines, the true displacement, screws and parts.

    `new_from_old` moves the camera.
    """
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = TILT, [0.0, 0.0, 1.3]
    world = new_from_old @ world
    tilt, origin = world[:3, :3], world[:3, 3]
    along, up, side = tilt.T
    time = np.linspace(0, 1, FRAMES)
    boxes: list[Box]
    parent: tuple[int, ...] = ()
    if kind in ("doors", "drawers", "door and drawer"):
        parent = (-1, -1)
        boxes = [(0, [0, 0.05, 0.16], [0.4, 0.3, 0.1]), (1, [-0.17, 0.05, 0], [0.16, 0.22, 0.03]),
                 (2, [0.17, 0, 0], [0.16, 0.22, 0.03])]
        prismatic = np.array([kind == "drawers", kind != "doors"])
        angle = np.stack([0.2 * time, 0.1 * time**1.5], axis=1)
        angle *= np.where(prismatic, 1.0, [4.0, -5.0])
        at = origin + np.array([[-0.33, 0, 0], [0.33, 0, 0]]) @ tilt.T
        turn = np.concatenate([up[None].repeat(2, axis=0), np.cross(at, up)], axis=1)
        slide = np.concatenate([-side, np.zeros(3)])
        screw = np.where(prismatic[:, None], slide, turn)
    elif kind == "slide":
        screw, prismatic = np.concatenate([along, np.zeros(3)])[None], np.array([True])
        angle = (0.15 * time)[:, None]
        boxes = [(0, [0, 0.2, 0], [0.25, 0.05, 0.1]), (1, [-0.1, 0.08, 0.02], [0.1, 0.07, 0.08])]
    else:
        base, elbow = origin + 0.3 * up, origin - 0.05 * up
        screw = np.stack([np.r_[up, np.cross(base, up)], np.r_[side, np.cross(elbow, side)]])
        prismatic = np.array([False, False])
        angle = np.stack([0.5 * time, -0.6 * time**1.3], axis=1)
        boxes = [(0, [0, 0.33, 0], [0.14, 0.04, 0.14]), (1, [0, 0.12, 0], [0.06, 0.16, 0.04]),
                 (2, [0.12, -0.08, 0], [0.2, 0.05, 0.06])]
    parents = np.array(parent or range(-1, len(screw) - 1))
    motion = part_motions(twists_of(screw, prismatic), angle, parents)
    depth, part = cast(motion, boxes, world)
    rgb = np.repeat((60 + 50 * part)[..., None], 3, axis=-1).astype(np.uint8)
    observation = Observation(
        rgb, depth, INTRINSICS, time, len(screw),
        tuple("prismatic" if p else "revolute" for p in prismatic),
        parent, axis_direction=screw[:, :3], axis_line=screw,
    )
    return observation, angle, screw, part


def told(observation: Observation, knowledge: str) -> Observation:
    """The observation with no more than some knowledge."""
    if knowledge != "kinematics":
        observation = replace(observation, axis_line=None)
    return replace(observation, axis_direction=None) if knowledge == "free" else observation


@pytest.mark.parametrize("kind", ["slide", "arm", "doors", "drawers"])
@pytest.mark.parametrize("knowledge", ["kinematics", "axes", "free"])
def test_exact_depth_gives_the_motion(kind: str, knowledge: str) -> None:
    observation, angle, screw, part = scene(kind)
    found = GCPose().estimate(told(observation, knowledge))
    assert found.screw is not None and found.part is not None and found.sigma is not None
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


def test_a_sweep_holds_the_first_steps_without_any_flow() -> None:
    observation, angle, _, _ = scene("arm")
    assert observation.depth is not None
    surfaces = surfaces_from_depth(observation.depth, INTRINSICS, ImageSettings())
    known = joint_priors(told(observation, "axes"))
    blank = np.zeros((*observation.depth.shape, 3), np.uint8)
    where = moving_mask(surfaces, blank, LabelSettings())
    tracker = Tracker(surfaces, blank, where, known, RgbdSettings(), 500)
    found = sweep_depth(tracker, 3, 12)
    off = [np.abs(h.state.angle[3] - angle[3]).max() for h in found]
    assert len(found) == 12 and min(off) < np.radians(4.0)
    assert all(a.cost <= b.cost for a, b in pairwise(found))
    assert tracker.coarser(100).base_candidates is tracker.base_candidates
    free = sweep_depth(Tracker(surfaces, blank, where, joint_priors(told(observation, "free")),
                         RgbdSettings(), 500), 3, 9)
    for h in free:  # upright, then along or across
        first, second = h.state.twist[:, :3]
        assert first[0] == 0 and first[1] < 0
        assert min(abs(first @ second), 1 - first @ second) < 1e-5


def test_the_true_motion_costs_least_and_blocks_change_nothing() -> None:
    observation, angle, screw, part = scene("arm")
    assert observation.depth is not None
    surfaces = surfaces_from_depth(observation.depth, INTRINSICS, ImageSettings())
    v, u = np.nonzero((part[0] == 2) & surfaces.normal[0].any(axis=2))
    column = columns(surfaces.points(0, np.stack([u, v], axis=1)), surfaces.normal[0, v, u])
    some = angle[5] + np.linspace(-0.2, 0.2, 41)[:, None]
    motion = part_motions(twists_of(screw, np.zeros(2, bool)), some, np.array([-1, 0]))[:, 2]
    judge = DepthStepCosts(surfaces, 5, column, RgbdSettings())
    cost = judge.costs(motion)
    assert abs(int(cost.mean(axis=1).argmin()) - 20) <= 1  # 0.6 deg from one to the next
    alone = np.stack([judge.costs(m[None])[0] for m in motion])
    assert np.allclose(cost, alone, atol=1e-4)


def test_places_are_spread_and_threads_keep_the_order() -> None:
    points = np.random.default_rng(0).random((200, 3))
    places = spread_places(points, 10)
    assert places.shape == (10, 3)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + np.eye(10)
    assert apart.min() > 0.15 and spread_places(points[:3], 10).shape == (3, 3)
    assert thread_map(lambda i: i * i, range(20)) == [i * i for i in range(20)]


def test_one_thread_gives_what_two_give(monkeypatch: pytest.MonkeyPatch) -> None:
    observation = told(scene("arm")[0], "axes")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    two = GCPose().estimate(observation)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    one = GCPose().estimate(observation)
    assert (one.displacement == two.displacement).all()


def test_an_axis_that_points_the_other_way_is_the_same_solution() -> None:
    _, angle, screw, _ = scene("arm")
    twist, kind = twists_of(screw, np.zeros(2, bool)), np.zeros(2, bool)
    one = Hypothesis(Articulation(twist, angle, kind, np.array([-1, 0])), (), 1.0)
    rotate = Articulation(twist * [[1], [-1]], angle * [1, -1], kind, np.array([-1, 0]))
    two = Hypothesis(rotate, (), 2.0)
    other = Hypothesis(replace(rotate, twist=twist), (), 3.0)
    settings = RgbdSettings()
    assert motion_difference(one, two, settings) < 1e-9
    assert motion_difference(one, other, settings) > 0.5
    assert select_by_motion([other, two, one], 3, settings) == [one, other]


def test_a_hinge_is_where_a_part_is_nearest_to_what_carries_it() -> None:
    rng = np.random.default_rng(4)
    points = rng.random((90, 3)) + np.repeat([[0, 0, 0], [1, 0, 0], [0, 2, 0]], 30, axis=0)
    label, base = np.repeat([1, 2, 3], 30), np.array([5.0, 5.0, 5.0])

    def nearest(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
        apart = np.linalg.norm(outer[:, None] - inner, axis=2).min(axis=1)
        return outer[np.argsort(apart)[: 1 + len(outer) // 12]].mean(axis=0)

    chain, fork = (locate_hinges(points, label, base, np.array(p), ChainSettings())
                   for p in ([-1, 0, 1], [-1, 0, 0]))
    assert (chain[0] == base).all() and (fork[0] == base).all()
    assert np.allclose(chain[1], nearest(points[:30], points[30:]))
    assert np.allclose(chain[2], nearest(points[:60], points[60:]))
    assert np.allclose(fork[1:], [nearest(points[:30], points[i : i + 30]) for i in (30, 60)])
    hidden = locate_hinges(points, np.where(label == 3, 0, label), base, np.array([-1, 0, 1]),
                    ChainSettings())
    assert (hidden[2] == hidden[1]).all()  # nothing is seen of it: its carrier's


def test_noisy_depth_gives_about_the_motion() -> None:
    observation, angle, _, _ = scene("arm")
    assert observation.depth is not None
    noise = np.random.default_rng(0).normal(0, 0.02, observation.depth.shape)
    depth = (observation.depth + noise).astype(np.float32)
    noisy = replace(observation, depth=depth, depth_noise=0.02)
    found = GCPose().estimate(noisy)
    assert np.abs(found.displacement[-1] - angle[-1]).max() < np.radians(4.0)


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
