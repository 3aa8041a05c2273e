"""GC-Pose without depth: exact measurements give exact angles at any scale, noise worse ones."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement

import cv2
import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.benchmark.methods import load, with_options
from gcbench.gcpose.articulation import Articulation
from gcbench.gcpose.beam import Beam, beamed, unlike
from gcbench.gcpose.chain import part_motions
from gcbench.gcpose.flow import Flow, dis_flow
from gcbench.gcpose.footage import CONTRAST, appearance, footage, moving_foreground
from gcbench.gcpose.knowledge import Known
from gcbench.gcpose.method import GCPose
from gcbench.gcpose.patches import match
from gcbench.gcpose.prior import Hinges
from gcbench.gcpose.ray_bundle import Fit, adjust_rays
from gcbench.gcpose.ray_costs import patch_costs
from gcbench.gcpose.ray_labels import (
    Spots,
    along_chain,
    along_tracks,
    disorder,
    labelled,
    spots,
)
from gcbench.gcpose.ray_points import Rays, places, slopes, warps
from gcbench.gcpose.ray_search import judged
from gcbench.gcpose.ray_sweep import ByFlow, at_depths
from gcbench.gcpose.ray_tracker import Guess, RayTracker
from gcbench.gcpose.ray_ways import distinct, tilted
from gcbench.gcpose.rgb import standing
from gcbench.renderer.observation import Observation
from gcbench.robots.geometry import inverse
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist

INTRINSICS = np.array([[600.0, 0, 160], [0, 600, 120], [0, 0, 1]])
FRAMES = 9


def chain(scale: float = 1.0) -> tuple[Articulation, np.ndarray]:
    """Three joints, two of them parallel, and where they are."""
    direction = np.array([[0.1, 0.9, 0.42], [0.95, 0.1, 0.3], [0.95, 0.1, 0.3]])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    at = scale * np.array([[0.0, 0.1, 1.0], [0.02, 0.04, 1.0], [0.0, -0.06, 0.95]])
    twist = np.concatenate([direction, np.cross(at, direction)], axis=1)
    time = np.linspace(0, 1, FRAMES)[:, None]
    angle = np.array([0.5, -0.6, 0.8]) * (3 * time**2 - 2 * time**3)
    return Articulation(twist, angle, np.zeros(3, bool), np.arange(-1, 2)), at


def measured(state: Articulation, scale: float, noise: float, steps: bool) -> Rays:
    """Points of two key frames with their places, or steps, in all frames."""
    rng = np.random.default_rng(4)
    n = 240
    label = rng.integers(1, 4, n)
    pixel = rng.uniform([100, 60], [220, 180], (n, 2))
    ray = np.concatenate([(pixel - INTRINSICS[:2, 2]) / 600.0, np.ones((n, 1))], axis=1)
    frame = np.where(np.arange(n) % 2, 0, 4)
    none, empty = np.zeros((n, FRAMES - 1, 2)), np.zeros((n, FRAMES - 1, 2, 2))
    start = np.ones(n)
    rays = Rays(frame, ray, label, rng.uniform(0.9, 1.1, n) / scale, start, none, empty,
                np.zeros((n, FRAMES, 2)), np.zeros((n, FRAMES, 2, 2)))
    at = places(state, rays, INTRINSICS)
    at = at + noise * rng.standard_normal(at.shape)
    sure = np.broadcast_to(np.eye(2) / 0.1**2, (*at.shape, 2))
    flat = replace(rays, inverse_depth=start)
    if steps:
        return replace(flat, step=np.diff(at, axis=1), step_information=sure[:, 1:])
    own = np.arange(FRAMES)[None] == frame[:, None]
    return replace(flat, spot=at, spot_information=np.where(own[..., None, None], 0.0, sure))


def adjusted(scale: float = 1.0, noise: float = 0.0, steps: bool = False) -> tuple[Fit, float]:
    """The fit from half the angles and displaced axes, and its largest error in degrees."""
    true, _ = chain(scale)
    rays = measured(true, scale, noise, steps)
    off, near = chain()
    hinges = Hinges(near + 0.01, 0.1)
    twist = off.twist.copy()
    twist[:, 3:] = np.cross(near + 0.01, twist[:, :3])
    state = replace(off, twist=twist, angle=0.5 * off.angle)
    fit = adjust_rays(state, rays, INTRINSICS, 2, (50.0,) * 10 + (5.0,) * 20, hinges, 1e-3)
    return fit, float(np.degrees(np.abs(fit.state.angle - true.angle).max()))


@pytest.mark.parametrize("steps", [False, True])
def test_exact_places_and_exact_flow_give_exact_angles(steps: bool) -> None:
    assert adjusted(steps=steps)[1] < 0.1


def test_a_sweep_holds_the_first_steps_by_flow() -> None:
    state, at = chain()
    rays = measured(state, 1.0, 0.0, False)
    mine = rays.frame == 0
    there = rays.spot[mine, 3]
    sure = np.tile([4.0, 0.0, 4.0], (len(there), 1))
    column = np.column_stack([rays.ray[mine, :2], there, sure])
    judge = ByFlow(np.ones((240, 320), bool), (600.0, 160.0, 120.0), column)
    motion = state.motions(4)[3]
    label = rays.label[mine]
    cost = judge.costs(motion)
    assert cost[label, np.arange(len(label))].max() < 0.5 < cost[0].mean()
    known = Known(state.prismatic, state.parent, state.twist[:, :3], None)
    beam = beamed(known, judge, at[:1], at, np.radians(13.0), 0.1, 1000)
    off = np.abs(beam.angle[:30] - state.angle[3]).max(axis=1)
    assert off.min() < np.radians(3.0)
    assert (np.diff(beam.cost.mean(axis=1)) >= 0).all()
    narrow = replace(judge, moving=np.zeros((240, 320), bool))
    assert (narrow.costs(motion) > 9.0).all()  # only background is seen there


def test_a_sweep_keeps_chains_of_unlike_steps() -> None:
    angle = np.array([[0.1, 0.0], [0.1, 0.0], [0.0, 0.1], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
    count = np.arange(6.0)
    beam = Beam(count, count, count, angle)
    assert unlike(beam, 9).cost.tolist() == [0, 2, 4]
    assert unlike(beam, 2).cost.tolist() == [0, 2]
    points = at_depths(np.array([[0.1, 0.2, 1.0], [0.0, -0.1, 1.0]]), (0.5, 2.0))
    assert points.tolist() == [[0.05, 0.1, 0.5], [0.2, 0.4, 2.0], [0, -0.05, 0.5], [0, -0.2, 2.0]]


def test_a_joint_that_nothing_carries_turns_about_a_root() -> None:
    state, at = chain()
    known = Known(state.prismatic, state.parent, state.twist[:, :3], None)
    judge = ByFlow(np.ones((240, 320), bool), (600.0, 160.0, 120.0),
                   np.array([[0.0, 0.1, 160.0, 180.0, 4.0, 0.0, 4.0]]))
    twist = beamed(known, judge, at[:1], at[1:], 0.2, 0.1, 50).twist
    away = np.stack([np.linalg.norm(np.cross(p, twist[..., :3]) - twist[..., 3:], axis=2)
                     for p in at])
    assert away[0, :, 0].max() < 1e-9
    assert away[1:, :, 1:].min(axis=0).max() < 1e-9 < away[0, :, 1:].min()


def neighbours(rays: Rays, most: int = 12) -> csr_array:
    """[N N] 1 for the nearest of each point in its key frame."""
    apart = cdist(rays.ray, rays.ray) + 9.0 * (rays.frame[:, None] != rays.frame)
    near = apart <= np.sort(apart, axis=1)[:, most - 1 : most]
    return csr_array(near.astype(np.float64))


def test_depths_of_neighbours_on_one_part_are_alike() -> None:
    true, at = chain()
    rays = measured(true, 1.0, 1.0, False)
    nearer = 1.0 + 0.2 * (rays.label == 2)  # each part is flat, one of them nearer
    there = places(true, replace(rays, inverse_depth=nearer), INTRINSICS)
    noise = 20.0 * np.random.default_rng(7).standard_normal(there.shape)
    sure = rays.spot_information * 0.1**2 / 20.0**2
    rays = replace(rays, spot=there + noise, spot_information=sure)
    scales = (3.0,) * 6
    alone, together = (
        adjust_rays(true, replace(rays, near=near), INTRINSICS, 2, scales, Hinges(at, 0.1))
        for near in (None, neighbours(rays))
    )
    for part in (1, 2, 3):
        mine = rays.label == part
        assert together.inverse_depth[mine].std() < 0.8 * alone.inverse_depth[mine].std()
    apart = [fit.inverse_depth[rays.label == 2].mean() - fit.inverse_depth[rays.label != 2].mean()
             for fit in (alone, together)]
    assert apart[1] > 0.7 * apart[0] > 0.05  # parts that are behind one another stay apart


def test_scale_does_not_matter() -> None:
    one, two = (adjusted(scale)[0].state.angle for scale in (1.0, 7.0))
    assert np.degrees(np.abs(one - two)).max() < 0.1


def test_noise_costs_accuracy() -> None:
    errors = [adjusted(noise=n)[1] for n in (0.0, 0.3, 3.0)]
    assert errors[0] < errors[1] < errors[2]


def test_places_are_those_of_the_chain() -> None:
    state, _ = chain()
    rays = measured(state, 1.0, 0.0, False)
    at, warp = places(state, rays, INTRINSICS), warps(state, rays)
    i = int(np.flatnonzero(rays.frame == 4)[0])
    motion = state.motions(len(state.angle))[:, rays.label[i]]
    moved = (motion @ inverse(motion[4]))[7] @ np.append(rays.ray[i], 1.0)
    assert np.allclose(at[i, 7], INTRINSICS[:2] @ moved[:3] / moved[2])
    assert np.allclose(at[i, 4], INTRINSICS[:2] @ rays.ray[i])
    assert np.allclose(warp[i, 4], np.eye(2))


def test_a_surface_is_distorted_as_it_lies() -> None:
    """As places of its other points tell, which nobody had to guess the slope of."""
    state, _ = chain()
    side = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0)), axis=2).reshape(-1, 2)
    pixel = np.array([130.0, 90.0]) + 4.0 * side
    ray = np.column_stack([(pixel - INTRINSICS[:2, 2]) / 600.0, np.ones(len(pixel))])
    label = np.where(side[:, 0] < 6, 1, 3)
    tilt = np.array([[0.9, -0.5], [-0.4, 1.2]])[label // 3]
    depth = 1.0 + 0.1 * (label == 3) + (tilt * ray[:, :2]).sum(axis=1)
    rays = Rays.unseen(np.full(len(ray), 4), ray, label, depth)
    rays = replace(rays, near=neighbours(rays))
    assert np.abs(slopes(rays) - tilt).max() < 0.5  # less than the slopes are
    flat = replace(rays, near=None)
    at = places(state, rays, INTRINSICS)
    i = 5 * 12 + 8  # the pixel before and after it on each side are on the same part
    across = np.stack([at[i + 1] - at[i - 1], at[i + 12] - at[i - 12]], axis=2) / 8.0
    apart = [np.abs(warps(state, r)[i, -1] - across[-1]).max() for r in (rays, flat)]
    assert apart[0] < 0.3 * apart[1]


def texture(rng: np.random.Generator, height: int, width: int, sigma: float = 1.5) -> np.ndarray:
    noise = cv2.GaussianBlur(rng.standard_normal((height, width, 3)), (0, 0), sigma)
    return (127 + 60 * noise / noise.std()).clip(0, 255).astype(np.uint8)


def test_a_patch_is_found_where_it_was_moved_to() -> None:
    rng = np.random.default_rng(1)
    gray = texture(rng, 90, 110)[..., 0].astype(np.float32)
    shift = np.array([1.4, -0.7])
    there = cv2.warpAffine(gray, np.array([[1, 0, shift[0]], [0, 1, shift[1]]]), (110, 90))
    inside = np.ones(gray.shape, bool)
    images = np.stack([appearance(gray, inside), appearance(there, inside)])
    pixel = np.array([[50.0, 40.0], [60.0, 50.0]])
    place = np.repeat(pixel[:, None], 2, axis=1)
    warp = np.broadcast_to(np.eye(2), (2, 2, 2, 2)).copy()
    wanted = np.array([[False, True]] * 2)
    found, information = match(images, pixel, np.zeros(2, np.int64), place, warp, wanted, 6, 4.0,
                               0.1, 0.0, CONTRAST, 2.0)
    assert np.abs(found[:, 1] - pixel - shift).max() < 0.05
    assert (np.linalg.eigvalsh(information[:, 1]) > 10).all()
    assert not information[:, 0].any()


def test_an_outline_tells_only_what_happens_across_it() -> None:
    gray = np.full((90, 110), 128, np.float32)
    half = np.arange(110)[None] + np.zeros((90, 1)) < 50
    moved = np.arange(110)[None] + np.zeros((90, 1)) < 52
    images = np.stack([appearance(gray, half), appearance(gray, moved)])
    pixel = np.array([[49.0, 45.0]])
    found, information = match(
        images, pixel, np.zeros(1, np.int64), np.repeat(pixel[:, None], 2, axis=1),
        np.eye(2)[None, None].repeat(2, axis=1), np.array([[False, True]]), 6, 4.0, 0.1, 0.0,
        CONTRAST, 2.0)  # fmt: skip
    assert np.allclose(found[0, 1], [51, 45], atol=0.1)
    assert information[0, 1, 0, 0] > 10
    assert abs(information[0, 1, 1, 1]) < 1e-6


def test_labels_along_the_chain_are_the_cheapest_in_order() -> None:
    rng = np.random.default_rng(3)
    cost, rank = rng.random((11, 3)), rng.random(11)
    label = along_chain(cost, rank, np.zeros(11, np.int64))[np.argsort(rank)]
    assert (np.diff(label) >= 0).all()
    ordered = cost[np.argsort(rank)]
    best = min(
        sum(ordered[i, a] for i, a in enumerate(labels))
        for labels in combinations_with_replacement(range(3), 11)
    )
    assert np.isclose(ordered[np.arange(11), label].sum(), best)


def test_patches_speak_for_the_part_that_moved_them() -> None:
    state, _ = chain()
    rays = measured(state, 1.0, 0.0, False)
    keys, key = np.unique(rays.frame, return_inverse=True)
    motion = state.motions(FRAMES)
    relative = np.stack([motion @ inverse(motion[k]) for k in keys])
    start = np.repeat(rays.inverse_depth[:, None], 3, axis=1)
    at = places(state, replace(rays, inverse_depth=rays.inverse_depth + 0.01), INTRINSICS)
    spot = at + 0.1 * np.random.default_rng(8).standard_normal(at.shape)

    def costs(information: np.ndarray) -> np.ndarray:
        return patch_costs(rays.ray, key, start, relative, 600.0, 160.0, 120.0, spot, information)

    cost = costs(rays.spot_information)
    assert (cost.argmin(axis=1) + 1 == rays.label).mean() > 0.97
    own = cost[np.arange(len(cost)), rays.label - 1]
    assert own.mean() < 3.0 < np.median(cost)  # of two coordinates, in the noise's variance
    few = np.where(np.arange(FRAMES)[:, None, None] > 4, rays.spot_information, 0.0)
    assert np.abs(costs(few) - cost).max() > 0.1
    assert not costs(0.0 * few).any()  # nothing was found, nothing is said


def two_frames(side: int = 8) -> Spots:
    """A row of pixels, ten apart, in frames 0 and 1; each is its own only neighbour."""
    at = np.stack([10 * np.arange(side) + 5, np.full(side, 5)], axis=1)
    frame = np.repeat([0, 1], side)
    nearest = (np.arange(10 * side) // 10)[None, None] + side * np.arange(2)[:, None, None]
    nearest = np.broadcast_to(nearest, (2, 10, 10 * side)).astype(np.int32)
    ray = np.ones((2 * side, 3))
    return Spots(frame, np.tile(at, (2, 1)), ray, ray[:, 0], None,
                 csr_array(np.eye(2 * side)), nearest)


def test_what_a_part_takes_a_pixel_to_has_a_say_in_its_label() -> None:
    points, side = two_frames(), 8
    cost = np.ones((2 * side, 2))
    cost[side + 3] = 5.0, 0.0  # pixel 3 of frame 1 is on part 1, as seen there
    place = np.repeat(points.pixel[:, None, None].astype(float), 2, axis=1).repeat(2, axis=2)
    place[:side, 1, 1, 0] += 20.0  # part 1 goes two pixels to the right
    place[side:, 0, 1, 0] -= 20.0
    label = along_tracks(points, cost, place).argmin(axis=1)
    assert label[1] == 1  # where pixel 3 of frame 1 comes from, on part 1
    assert label[side + 3] == 1
    assert (np.delete(label, [1, 3, side + 3]) == 0).all()  # pixel 3 would be gone on part 0
    place[:] = -50.0  # outside of the image nothing is said
    assert (along_tracks(points, cost, place) == cost).all()


def test_labels_keep_to_the_order_unless_they_say_otherwise() -> None:
    points, side = two_frames(), 8
    cost = np.zeros((2 * side, 2))
    cost[:, 1] = np.where(np.arange(2 * side) % side < 4, 3.0, -3.0)
    cost[6] = 0.0, 0.1  # beyond the joint, and not sure of itself
    cost[7] = 0.0, 2.0  # beyond the joint, and folded back
    rank = np.tile(np.linspace(0, 1, side), 2)
    assert labelled(points, cost, rank)[:side].tolist() == [0, 0, 0, 0, 1, 1, 1, 0]


def test_disorder_is_the_share_of_pairs_against_the_chain() -> None:
    rank, frame = np.array([0.1, 0.5, 0.3, 0.9, 0.2, 0.4]), np.array([0, 0, 0, 0, 7, 7])
    assert disorder(np.array([0, 2, 1, 2, 1, 1]), rank, frame) == 0.0
    assert disorder(np.array([2, 1, 1, 0, 1, 0]), rank, frame) == 6 / 7
    rng = np.random.default_rng(3)
    label, rank, frame = rng.integers(0, 4, 50), rng.random(50), rng.integers(0, 3, 50)
    pairs = [(i, j) for i in range(50) for j in range(50)
             if frame[i] == frame[j] and rank[i] < rank[j]]
    against = [label[i] > label[j] for i, j in pairs]
    assert np.isclose(disorder(label, rank, frame), np.mean(against))


def door(total: float) -> Observation:
    """A textured panel that turns about an upright axis before a textured wall."""
    rng = np.random.default_rng(5)
    wall, panel = texture(rng, 180, 240, 3.0), texture(rng, 100, 100)
    k = np.array([[260.0, 0, 119.5], [0, 260.0, 89.5], [0, 0, 1]])
    axis = np.array([0.12, 0.96, 0.25])
    axis /= np.linalg.norm(axis)
    line = np.concatenate([axis, np.cross([-0.15, 0.0, 1.2], axis)])
    time = np.linspace(0, 1, 8)
    motion = part_motions(line[None], total * time[:, None], np.array([-1]))[:, 1]
    corner = np.array([[-0.15, -0.16, 1.2], [0.2, -0.16, 1.1],
                       [0.2, 0.16, 1.1], [-0.15, 0.16, 1.2]])
    frames: list[np.ndarray] = []
    for m in motion:
        at = (corner @ m[:3, :3].T + m[:3, 3]) @ k.T
        source = np.array([[0, 0], [99, 0], [99, 99], [0, 99]], np.float32)
        h = cv2.getPerspectiveTransform(source, (at[:, :2] / at[:, 2:]).astype(np.float32))
        mask = cv2.warpPerspective(np.full((100, 100), 255, np.uint8), h, (240, 180)) > 127
        moved = cv2.warpPerspective(panel, h, (240, 180))
        frames.append(np.where(mask[..., None], moved, wall))
    return Observation(np.stack(frames), None, k, time, 1, ("revolute",),
                       cam_from_world=np.eye(4), axis_direction=axis[None])


def test_the_foreground_is_what_moves() -> None:
    rng = np.random.default_rng(2)
    wall, box = texture(rng, 100, 120), texture(rng, 30, 30)
    video = np.repeat(wall[None], 6, axis=0)
    truth = np.zeros(video.shape[:3], bool)
    for t in range(6):
        video[t, 30:60, 10 + 14 * t : 40 + 14 * t] = box
        truth[t, 30:60, 10 + 14 * t : 40 + 14 * t] = True
    found = moving_foreground(video)
    assert np.mean(found != truth) < 0.003
    assert not moving_foreground(np.repeat(wall[None], 4, axis=0)).any()


def test_a_flow_of_cuts_is_told_how_large_the_images_are() -> None:
    observation, told = door(0.3), list[tuple[int, int]]()

    class Sized:
        def for_cuts_of(self, height: int, width: int) -> Flow:
            told.append((height, width))
            return dis_flow

        def __call__(self, rgb_a: np.ndarray, rgb_b: np.ndarray) -> np.ndarray:
            raise AssertionError("seen at another scale")

    seen = footage(observation.rgb, observation.intrinsics, Sized())
    assert told == [(180, 240)] and seen is not None
    assert seen.flow.shape[1:3] < (180, 240)


def test_a_door_opens_without_depth() -> None:
    observation = door(0.5)
    estimate = GCPose("dis").estimate(observation)
    assert estimate.part is not None
    assert estimate.part.shape == (8, 180, 240)
    assert np.degrees(np.abs(estimate.displacement[:, 0] - 0.5 * np.linspace(0, 1, 8)).max()) < 2.0
    assert estimate.sigma is not None
    assert estimate.sigma[0] == 0


def test_a_machine_of_several_joints_stands_at_the_origin_of_the_world() -> None:
    observation = replace(door(0.5), joint_types=("revolute",) * 2, n_joints=2)
    assert observation.rgb is not None
    seen = footage(observation.rgb, observation.intrinsics, GCPose("dis").flow)
    assert seen is not None

    def base(*at: float, of: Observation = observation) -> np.ndarray | None:
        world = np.eye(4)
        world[:3, 3] = at
        return standing(replace(of, cam_from_world=world), seen)

    near = base(0.1, 0.3, 2.0)
    assert near is not None
    assert np.allclose(near, [0.05, 0.15, 1.0])
    assert base(0.1, 0.3, -2.0) is None  # behind the camera
    assert base(3.0, 0.3, 2.0) is None  # too far away for what moves
    assert base(0.1, 0.3, 2.0, of=door(0.5)) is None  # a door is not hinged at its middle
    assert base(0.1, 0.3, 2.0, of=replace(observation, joint_parent=(-1, -1))) is None
    assert base(0.1, 0.3, 2.0, of=replace(observation, axis_line=np.zeros((2, 6)))) is None
    assert standing(replace(observation, cam_from_world=None), seen) is None


def test_of_two_that_explain_as_much_the_surer_is_chosen() -> None:
    state, at = chain()
    empty = np.zeros(0)
    rays = Rays.unseen(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.int64), empty)
    held = state.angle[1:].size
    sure = Guess(state, rays, at[0], 3.0, 4.0 * np.eye(held + 6), 2.0)
    unsure = replace(sure, hessian=np.diag(np.tile([4.0, 0.04, 4.0], held // 3 + 2)))
    assert np.allclose(sure.deviation(), 0.5)
    assert np.allclose(unsure.deviation()[:, 1], 5.0, rtol=1e-3)
    assert judged(sure) < judged(unsure) < judged(replace(sure, cost=3.3))
    assert judged(replace(sure, flow_cost=2.1)) > judged(sure)
    assert judged(replace(sure, disorder=0.1)) > judged(sure)
    assert judged(replace(sure, unhinged=0.5)) > judged(sure)
    surest = replace(sure, hessian=1e6 * sure.hessian)
    assert judged(surest) < judged(sure)
    assert judged(surest) == judged(replace(sure, hessian=1e8 * sure.hessian))


def test_axes_should_pass_where_their_parts_begin() -> None:
    observation = door(0.5)
    assert observation.rgb is not None
    seen = footage(observation.rgb, observation.intrinsics, GCPose("dis").flow)
    assert seen is not None
    state, at = chain()
    end = np.array([0.05, -0.12, 0.95])
    point = np.concatenate([np.linspace(a, b, 30)
                            for a, b in zip(at, [*at[1:], end], strict=True)])
    rays = Rays.unseen(np.zeros(90, np.int64), point / point[:, 2:], np.repeat([1, 2, 3], 30),
                       1 / point[:, 2])
    guess = Guess(state, rays, at[0], 3.0, np.eye(1))
    tracker = RayTracker(seen, Known(state.prismatic, state.parent, state.twist[:, :3], None))
    assert tracker.unhinged(guess) < 0.02

    def moved(joint: int) -> Guess:
        line = state.twist[joint, :3]
        away = 0.2 * np.cross(line, [0, 0, 1.0]) / np.linalg.norm(np.cross(line, [0, 0, 1.0]))
        twist = state.twist.copy()
        twist[joint, 3:] += np.cross(away, line)
        return replace(guess, state=replace(state, twist=twist))

    assert 0.4 < tracker.unhinged(moved(2)) < 0.6
    assert tracker.unhinged(moved(0)) == tracker.unhinged(guess)  # the base is not seen to begin


def test_a_door_may_lie_in_any_plane_through_its_axis() -> None:
    """One of them is about the true one, at a scale at which points are about at 1."""
    whole, at = chain()
    state = replace(whole, twist=whole.twist[:1], angle=whole.angle[:, :1],
                    prismatic=whole.prismatic[:1], parent=whole.parent[:1])
    line = state.twist[0, :3]
    across = np.cross(line, [0.9, 0.1, 0.4])
    across /= np.linalg.norm(across)
    rng = np.random.default_rng(9)
    frame = np.repeat([0, 4], 100)
    pixel = rng.uniform([60, 60], [150, 180], (200, 2))
    ray = np.concatenate([(pixel - INTRINSICS[:2, 2]) / 600.0, np.ones((200, 1))], axis=1)
    turned = state.motions(FRAMES)[frame, 1, :3, :3] @ across
    true = np.einsum("na,na->n", turned, ray) / (across @ at[0])
    rays = Rays.unseen(frame, ray, np.ones(200, np.int64), np.ones(200))
    guess = Guess(state, rays, at[0], 3.0, np.eye(1))
    found = tilted(guess)
    assert len(found) > 2
    assert all(abs(g.rays.inverse_depth.mean() - 1.0) < 0.05 for g in found)
    off = [np.abs(g.rays.inverse_depth - true / true.mean()).max() for g in found]
    assert min(off) < 0.03 < np.abs(1.0 - true / true.mean()).max()
    best = found[int(np.argmin(off))].state.twist[0]
    assert np.allclose(best[3:], true.mean() * state.twist[0, 3:], rtol=0.05)
    assert not tilted(replace(guess, state=whole))
    assert not tilted(replace(guess, state=replace(state, prismatic=np.ones(1, bool))))


def test_the_best_that_differ_are_those_of_the_measure_that_is_asked_for() -> None:
    state, at = chain()
    rays = Rays.unseen(np.zeros(1, np.int64), np.ones((1, 3)), np.ones(1, np.int64), np.ones(1))
    first = Guess(state, rays, at[0], 3.0, np.eye(1), 2.0)
    alike = replace(first, cost=4.0, flow_cost=1.0)
    other = replace(first, cost=5.0, state=replace(state, angle=2 * state.angle), flow_cost=1.5)
    assert distinct([other, alike, first], 9) == [first, other]
    assert distinct([other, alike, first], 9, by=lambda g: g.flow_cost) == [alike, other]
    assert distinct([other, alike, first], 1) == [first]
    labels = np.full(1, 2)
    unlike = replace(first, cost=3.5, rays=replace(rays, label=labels))
    assert distinct([other, unlike, first], 9) == [first, unlike, other]
    assert distinct([other, unlike, first], 9, differ=1.0) == [first, other]


def test_nothing_moves_and_nothing_breaks() -> None:
    still = replace(door(0.0), axis_direction=None, cam_from_world=None)
    estimate = GCPose().estimate(still)
    assert not estimate.displacement.any()
    assert estimate.sigma is not None
    assert (estimate.sigma[1:] > 0.5).all()


def test_pixels_that_are_not_square_are_refused() -> None:
    observation = door(0.5)
    oblong = observation.intrinsics * np.array([[1.0], [1.2], [1.0]])
    with pytest.raises(GcbenchError, match="square pixels"):
        GCPose("dis").estimate(replace(observation, intrinsics=oblong))


def test_spots_stay_on_what_moves() -> None:
    observation = door(0.5)
    assert observation.rgb is not None
    seen = footage(observation.rgb, observation.intrinsics, GCPose("dis").flow)
    assert seen is not None
    found = spots(seen, (0, 4), 60)
    assert seen.moving[found.frame, found.pixel[:, 1], found.pixel[:, 0]].all()
    assert set(found.frame) == {0, 4}


def test_options_make_another_row() -> None:
    source = "gcbench.gcpose.method:GCPose"
    assert (load(source).name, load(source).training) == ("gcpose", "none")
    assert load(with_options(source, {"flow": "dis"})).name == "gcpose flow=dis"
    with pytest.raises(GcbenchError, match="no flow 'magic'"):
        load(with_options(source, {"flow": "magic"}))
    with pytest.raises(GcbenchError, match="takes no --flow"):
        load(with_options("gcbench.benchmark.baselines:HoldStill", {"flow": "dis"}))
