"""GC-Pose without depth: exact measurements give exact angles at any scale, noise worse ones."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from gcbench.gcpose.chain.articulation import Articulation
from gcbench.gcpose.chain.beam import Beam, StepGrid, beam_search, select_by_steps
from gcbench.gcpose.chain.priors import JointPriors
from gcbench.gcpose.chain.settings import ChainSettings
from gcbench.gcpose.chain.weak_prior import HingePrior
from gcbench.gcpose.estimator import adjust
from gcbench.gcpose.images.patches import PredictedPatches, find_patches
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import appearance
from gcbench.gcpose.numerics import Solver
from gcbench.gcpose.rgb.evidence import VideoAdjustment, VideoHypothesis
from gcbench.gcpose.rgb.flow_sweep import flow_step_costs, places_at_depths
from gcbench.gcpose.rgb.measurements import drop_points_at_rest
from gcbench.gcpose.rgb.points import (
    InverseDepthPoints,
    inverse_depth_slopes,
    predict_places,
    predict_warps,
)
from gcbench.gcpose.rgb.residuals import RayResiduals, smoothness_blocks
from gcbench.gcpose.rgb.settings import RgbSettings
from gcbench.robots.geometry import inverse
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist

from ...support.ray_scenes import INTRINSICS, chain, measured, texture

SETTINGS = RgbSettings(patch_weight=1.0)


class Measured:
    """Evidence of points whose places are known in advance."""

    def __init__(self, state: Articulation, hinges: HingePrior) -> None:
        self.priors = JointPriors(state.prismatic, state.parent, state.twist[:, :3], None)
        self.solver = Solver(SETTINGS.damping, 1e-6, max_step=SETTINGS.max_step, scaled=True)
        self.chain, self.prior = SETTINGS.chain, hinges

    def hinges(self, hypothesis: VideoHypothesis) -> HingePrior:
        return self.prior

    def measure(self, hypothesis: VideoHypothesis, how: VideoAdjustment) -> RayResiduals:
        points = hypothesis.points
        return RayResiduals(points, INTRINSICS, how.depth_sigma,
                            smoothness_blocks(points, SETTINGS), SETTINGS)

    def label(self, hypothesis: VideoHypothesis, where: None) -> VideoHypothesis:
        return hypothesis


def fitted(
    state: Articulation, points: InverseDepthPoints, hinges: HingePrior, how: VideoAdjustment
) -> VideoHypothesis:
    start = VideoHypothesis(state, points, hinges.point[0], 0.0)
    return adjust(Measured(state, hinges), start, how)


def adjusted(
    scale: float = 1.0, noise: float = 0.0, steps: bool = False
) -> tuple[VideoHypothesis, float]:
    """The fit from half the angles and displaced axes, and its largest error in degrees."""
    true, _ = chain(scale)
    rays = measured(true, scale, noise, steps)
    off, near = chain()
    hinges = HingePrior(near + 0.01, 0.1, near + 0.01)
    twist = off.twist.copy()
    twist[:, 3:] = np.cross(near + 0.01, twist[:, :3])
    state = replace(off, twist=twist, angle=0.5 * off.angle)
    fit = fitted(state, rays, hinges, VideoAdjustment((50.0,) * 10 + (5.0,) * 20, prior=1e-3))
    return fit, float(np.degrees(np.abs(fit.state.angle - true.angle).max()))


@pytest.mark.parametrize("steps", [False, True])
def test_exact_places_and_exact_flow_give_exact_angles(steps: bool) -> None:
    assert adjusted(steps=steps)[1] < 0.1


def test_points_that_rest_do_not_slow_the_turn_of_the_part_on_the_base() -> None:
    true, near = chain()
    hinges, how = HingePrior(near, 0.1, near), VideoAdjustment((50.0,) * 20, prior=1e-3)
    exact = fitted(true, measured(true, 1.0, 0.0, False), hinges, how)
    state, points = exact.state, exact.points
    own = predict_places(state, points, INTRINSICS)[np.arange(len(points.ray)), points.frame]
    still = (points.label == 1) & (np.random.default_rng(3).random(len(own)) < 0.5)
    mixed = replace(points, place=np.where(still[:, None, None], own[:, None], points.place))
    kept = drop_points_at_rest(state, mixed, INTRINSICS, points.label == 1, SETTINGS)
    assert np.array_equal(kept.place_information.any(axis=(1, 2, 3)), ~still)
    other = drop_points_at_rest(state, mixed, INTRINSICS, points.label == 2, SETTINGS)
    assert np.array_equal(other.place_information, mixed.place_information)
    slowed, mended = (fitted(state, some, hinges, how).state.angle[-1, 0] / true.angle[-1, 0]
                      for some in (mixed, kept))
    assert slowed < 0.98
    assert mended == pytest.approx(1.0, abs=0.01)


def test_a_sweep_holds_the_first_steps_by_flow() -> None:
    state, at = chain()
    rays = measured(state, 1.0, 0.0, False)
    mine = rays.frame == 0
    there = rays.place[mine, 3]
    sure = np.tile([4.0, 0.0, 4.0, 1.0], (len(there), 1))
    column = np.column_stack([rays.ray[mine, :2], there, sure])
    flow = flow_step_costs(np.ones((240, 320), bool), (600.0, 160.0, 120.0), column, SETTINGS)
    motion = state.motions(4)[3]
    label = rays.label[mine]
    cost = flow.costs(motion)
    assert cost[label, np.arange(len(label))].max() < 0.5 < cost[0].mean()
    known = JointPriors(state.prismatic, state.parent, state.twist[:, :3], None)
    grid = StepGrid(at[:1], at, np.radians(13.0), 0.1, 1000)
    beam = beam_search(known, flow, grid, ChainSettings())
    off = np.abs(beam.angle[:30] - state.angle[3]).max(axis=1)
    assert off.min() < np.radians(3.0)
    assert (np.diff(beam.cost.mean(axis=1)) >= 0).all()
    narrow = flow_step_costs(np.zeros((240, 320), bool), (600.0, 160.0, 120.0), column, SETTINGS)
    assert (narrow.costs(motion) > 9.0).all()  # only background is seen there


def test_a_sweep_keeps_chains_of_unlike_steps() -> None:
    angle = np.array([[0.1, 0.0], [0.1, 0.0], [0.0, 0.1], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
    count = np.arange(6.0)
    beam = Beam(count, count, count, angle)
    assert select_by_steps(beam, 9).cost.tolist() == [0, 2, 4]
    assert select_by_steps(beam, 2).cost.tolist() == [0, 2]
    points = places_at_depths(np.array([[0.1, 0.2, 1.0], [0.0, -0.1, 1.0]]), (0.5, 2.0))
    assert points.tolist() == [[0.05, 0.1, 0.5], [0.2, 0.4, 2.0], [0, -0.05, 0.5], [0, -0.2, 2.0]]


def test_a_joint_that_nothing_carries_turns_about_a_root() -> None:
    state, at = chain()
    known = JointPriors(state.prismatic, state.parent, state.twist[:, :3], None)
    flow = flow_step_costs(np.ones((240, 320), bool), (600.0, 160.0, 120.0),
                      np.array([[0.0, 0.1, 160.0, 180.0, 4.0, 0.0, 4.0, 1.0]]), SETTINGS)
    twist = beam_search(known, flow, StepGrid(at[:1], at[1:], 0.2, 0.1, 50), ChainSettings()).twist
    away = np.stack([np.linalg.norm(np.cross(p, twist[..., :3]) - twist[..., 3:], axis=2)
                     for p in at])
    assert away[0, :, 0].max() < 1e-9
    assert away[1:, :, 1:].min(axis=0).max() < 1e-9 < away[0, :, 1:].min()


def neighbors(rays: InverseDepthPoints, most: int = 12) -> csr_array:
    """[N N] 1 for the nearest of each point in its key frame."""
    apart = cdist(rays.ray, rays.ray) + 9.0 * (rays.frame[:, None] != rays.frame)
    near = apart <= np.sort(apart, axis=1)[:, most - 1 : most]
    return csr_array(near.astype(np.float64))


def test_depths_of_neighbours_on_one_part_are_alike() -> None:
    true, at = chain()
    rays = measured(true, 1.0, 1.0, False)
    nearer = 1.0 + 0.2 * (rays.label == 2)  # each part is flat, one of them nearer
    there = predict_places(true, replace(rays, inverse_depth=nearer), INTRINSICS)
    noise = 20.0 * np.random.default_rng(7).standard_normal(there.shape)
    sure = rays.place_information * 0.1**2 / 20.0**2
    rays = replace(rays, place=there + noise, place_information=sure)
    alone, together = (
        fitted(true, replace(rays, neighbors=near), HingePrior(at, 0.1, at),
               VideoAdjustment((3.0,) * 6)).points.inverse_depth
        for near in (None, neighbors(rays))
    )
    for part in (1, 2, 3):
        mine = rays.label == part
        assert together[mine].std() < 0.8 * alone[mine].std()
    apart = [depth[rays.label == 2].mean() - depth[rays.label != 2].mean()
             for depth in (alone, together)]
    assert apart[1] > 0.7 * apart[0] > 0.05  # parts that are behind one another stay apart


def test_the_smoothness_of_all_points_falls_into_blocks_of_parts() -> None:
    state, _ = chain()
    rays = measured(state, 1.0, 0.0, False)
    pairs = neighbors(rays)
    rays = replace(rays, neighbors=pairs)
    near = pairs.toarray() * (rays.label[:, None] == rays.label)
    weight = near / near.sum(axis=1, keepdims=True) / SETTINGS.neighbor_depth_sigma**2
    weight = (weight + weight.T) / 2
    whole = np.zeros(near.shape)
    for mine, block in smoothness_blocks(rays, SETTINGS):
        assert len({(f, p) for f, p in zip(rays.frame[mine], rays.label[mine], strict=True)}) == 1
        whole[np.ix_(mine, mine)] += block
    assert np.allclose(whole, np.diag(weight.sum(axis=1)) - weight)
    none, no = np.zeros(0, np.int64), np.zeros(0)
    empty = InverseDepthPoints.without_measurements(none, np.zeros((0, 3)), none, no)
    assert smoothness_blocks(empty, SETTINGS) == []


def test_slopes_are_those_of_planes_by_least_squares() -> None:
    state, _ = chain()
    rays, rng = measured(state, 1.0, 0.0, False), np.random.default_rng(3)
    depth = 1.0 + 0.01 * rng.standard_normal(len(rays.ray))
    pairs = neighbors(rays)
    rays = replace(rays, neighbors=pairs, inverse_depth=depth)
    slopes = inverse_depth_slopes(rays, SETTINGS)
    pair = pairs.toarray()
    around = pair @ pair > 0
    ridge = SETTINGS.plane_depth_sigma / SETTINGS.slope_sigma * np.eye(2)
    for i in range(0, len(depth), 7):
        mine = around[i] & (rays.label == rays.label[i])
        at, q = rays.ray[mine, :2], depth[mine]
        rows = np.vstack([at - at.mean(axis=0), ridge])
        fit = np.linalg.lstsq(rows, np.append(q - q.mean(), [0.0, 0.0]), rcond=None)[0]
        limit = min(1.0, SETTINGS.max_slope / max(SETTINGS.max_slope, np.linalg.norm(fit)))
        assert np.allclose(slopes[i], limit * fit)


def test_scale_does_not_matter() -> None:
    one, two = (adjusted(scale)[0].state.angle for scale in (1.0, 7.0))
    assert np.degrees(np.abs(one - two)).max() < 0.1


def test_noise_costs_accuracy() -> None:
    errors = [adjusted(noise=n)[1] for n in (0.0, 0.3, 3.0)]
    assert errors[0] < errors[1] < errors[2]


def test_places_are_those_of_the_chain() -> None:
    state, _ = chain()
    rays = measured(state, 1.0, 0.0, False)
    at = predict_places(state, rays, INTRINSICS)
    warp = predict_warps(state, rays, inverse_depth_slopes(rays, SETTINGS))
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
    rays = InverseDepthPoints.without_measurements(np.full(len(ray), 4), ray, label, depth)
    rays = replace(rays, neighbors=neighbors(rays))
    slopes = inverse_depth_slopes(rays, SETTINGS)
    assert np.abs(slopes - tilt).max() < 0.5  # less than the slopes are
    flat = replace(rays, neighbors=None)
    at = predict_places(state, rays, INTRINSICS)
    i = 5 * 12 + 8  # the pixel before and after it on each side are on the same part
    across = np.stack([at[i + 1] - at[i - 1], at[i + 12] - at[i - 12]], axis=2) / 8.0
    apart = [np.abs(predict_warps(state, rays, slope)[i, -1] - across[-1]).max()
             for slope in (slopes, inverse_depth_slopes(flat, SETTINGS))]
    assert apart[0] < 0.3 * apart[1]


def test_a_patch_is_found_where_it_was_moved_to() -> None:
    rng = np.random.default_rng(1)
    gray = texture(rng, 90, 110)[..., 0].astype(np.float32)
    shift = np.array([1.4, -0.7])
    there = cv2.warpAffine(gray, np.array([[1, 0, shift[0]], [0, 1, shift[1]]]), (110, 90))
    inside = np.ones(gray.shape, bool)
    images = np.stack([appearance(image, inside, ImageSettings()) for image in (gray, there)])
    pixel = np.array([[50.0, 40.0], [60.0, 50.0]])
    place = np.repeat(pixel[:, None], 2, axis=1)
    warp = np.broadcast_to(np.eye(2), (2, 2, 2, 2)).copy()
    wanted = np.array([[False, True]] * 2)
    patches = PredictedPatches(
        pixel, np.zeros(2, np.int64), place, warp, wanted, np.array([[True, False]] * 2), 4.0)
    found, information = find_patches(
        images, patches, ImageSettings(patch_radius=6, patch_sigma=0.1, patch_rate=0.0))
    assert np.abs(found[:, 1] - pixel - shift).max() < 0.05
    assert (np.linalg.eigvalsh(information[:, 1]) > 10).all()
    assert not information[:, 0].any()


def test_an_outline_tells_only_what_happens_across_it() -> None:
    gray = np.full((90, 110), 128, np.float32)
    half = np.arange(110)[None] + np.zeros((90, 1)) < 50
    moved = np.arange(110)[None] + np.zeros((90, 1)) < 52
    images = np.stack([appearance(gray, mask, ImageSettings()) for mask in (half, moved)])
    pixel = np.array([[49.0, 45.0]])
    patches = PredictedPatches(
        pixel, np.zeros(1, np.int64), np.repeat(pixel[:, None], 2, axis=1),
        np.eye(2)[None, None].repeat(2, axis=1), np.array([[False, True]]),
        np.array([[False, True]]), 4.0)
    found, information = find_patches(
        images, patches, ImageSettings(patch_radius=6, outline_sigma=0.1, outline_rate=0.0))
    assert np.allclose(found[0, 1], [51, 45], atol=0.1)
    assert information[0, 1, 0, 0] > 10
    assert abs(information[0, 1, 1, 1]) < 1e-6
