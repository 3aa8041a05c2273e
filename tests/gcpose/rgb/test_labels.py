"""GC-Pose without depth: parts are where their motion explains the images, in the chain's order."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest
from gcbench.gcpose.rgb.costs import MovedRays, flow_costs, patch_costs
from gcbench.gcpose.rgb.labels import (
    SampledPixels,
    assign_labels,
    average_along_tracks,
    label_inversions,
    ordered_labels,
)
from gcbench.gcpose.rgb.outline import Outline
from gcbench.gcpose.rgb.points import predict_places
from gcbench.gcpose.rgb.settings import RgbSettings
from gcbench.robots.geometry import inverse
from scipy.sparse import csr_array

from ...support.ray_scenes import FRAMES, INTRINSICS, chain, measured


def test_labels_along_the_chain_are_the_cheapest_in_order() -> None:
    rng = np.random.default_rng(3)
    cost, rank = rng.random((11, 3)), rng.random(11)
    label = ordered_labels(cost, rank, np.zeros(11, np.int64))[np.argsort(rank)]
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
    at = predict_places(state, replace(rays, inverse_depth=rays.inverse_depth + 0.01), INTRINSICS)
    spot = at + 0.1 * np.random.default_rng(8).standard_normal(at.shape)

    def costs(information: np.ndarray) -> np.ndarray:
        moved = MovedRays(rays.ray, key, relative, (600.0, 160.0, 120.0))
        return patch_costs(moved, start, spot, information, RgbSettings())

    cost = costs(rays.place_information)
    assert (cost.argmin(axis=1) + 1 == rays.label).mean() > 0.97
    own = cost[np.arange(len(cost)), rays.label - 1]
    assert own.mean() < 3.0 < np.median(cost)  # of two coordinates, in the noise's variance
    few = np.where(np.arange(FRAMES)[:, None, None] > 4, rays.place_information, 0.0)
    assert np.abs(costs(few) - cost).max() > 0.1
    assert not costs(0.0 * few).any()  # nothing was found, nothing is said


def flow_cost(
    records: np.ndarray, motion: np.ndarray, ray: np.ndarray, q: float, s: RgbSettings
) -> float:
    """The cost of one point by its definition; motion [T 4 4]."""
    limit, total, count = s.outlier_width**2, 0.0, 0
    at = np.stack([INTRINSICS @ (m[:3, :3] @ ray + q * m[:3, 3]) for m in motion])
    at = at[:, :2] / at[:, 2:]
    height, width = records.shape[1:3]
    for t, (u, v) in enumerate(at):
        if not (-0.5 < u < width - 0.5 and -0.5 < v < height - 0.5):
            continue
        count += 1
        flow, (uu, uv, vv), moving = np.split(records[t, round(v), round(u)], [2, 5])
        if not moving:
            total += s.background_cost * limit
        elif t + 1 < len(motion):
            off = flow - (at[t + 1] - at[t])
            e = off @ np.array([[uu, uv], [uv, vv]]) @ off
            e /= s.flow_sigma**2 + s.flow_rate**2 * (flow @ flow)
            total += limit * e / (limit + e)
    return total / max(1, count)


@pytest.mark.parametrize("frames", [2, 8, 9, 17, 18, 33])
def test_flow_costs_are_those_of_their_definition(frames: int) -> None:
    rng, s = np.random.default_rng(frames), RgbSettings()
    state, _ = chain()
    records = rng.random((frames, 240, 320, 6), np.float32)
    records[..., 3] *= np.sqrt(records[..., 2] * records[..., 4])  # no confidence is negative
    records[..., 5] = rng.random((frames, 240, 320)) < 0.8
    angle = 0.02 * state.angle[-1] * np.arange(frames)[:, None]
    motion = replace(state, angle=angle).motions(frames)[None]
    ray = np.concatenate([rng.uniform(-0.4, 0.4, (60, 2)), np.ones((60, 1))], axis=1)
    depth = rng.uniform(0.7, 1.4, (60, 3))
    rays = MovedRays(ray, np.zeros(60, np.int64), motion, (600.0, 160.0, 120.0))
    cost, same = flow_costs(rays, np.ones(60), depth, records, 0, s)
    expected = np.array([[flow_cost(records, motion[0, :, 1 + p], ray[i], depth[i, p], s)
                          for p in range(3)] for i in range(60)])
    # rounding may lead to the next pixel
    assert np.isclose(cost, expected, rtol=1e-3, atol=1e-3).mean() > 0.99
    np.testing.assert_array_equal(same, depth)
    assert expected.std() > 1


def two_frames(side: int = 8) -> SampledPixels:
    """A row of pixels, ten apart, in frames 0 and 1; each is its own only neighbour."""
    at = np.stack([10 * np.arange(side) + 5, np.full(side, 5)], axis=1)
    frame = np.repeat([0, 1], side)
    nearest = (np.arange(10 * side) // 10)[None, None] + side * np.arange(2)[:, None, None]
    nearest = np.broadcast_to(nearest, (2, 10, 10 * side)).astype(np.int32)
    ray = np.ones((2 * side, 3))
    return SampledPixels(frame, np.tile(at, (2, 1)), ray, ray[:, 0], None,
                         Outline.none(2 * side), csr_array(np.eye(2 * side)), nearest)


def test_what_a_part_takes_a_pixel_to_has_a_say_in_its_label() -> None:
    points, side = two_frames(), 8
    cost = np.ones((2 * side, 2))
    cost[side + 3] = 5.0, 0.0  # pixel 3 of frame 1 is on part 1, as seen there
    place = np.repeat(points.pixel[:, None, None].astype(float), 2, axis=1).repeat(2, axis=2)
    place[:side, 1, 1, 0] += 20.0  # part 1 goes two pixels to the right
    place[side:, 0, 1, 0] -= 20.0
    label = average_along_tracks(points, cost, place).argmin(axis=1)
    assert label[1] == 1  # where pixel 3 of frame 1 comes from, on part 1
    assert label[side + 3] == 1
    assert (np.delete(label, [1, 3, side + 3]) == 0).all()  # pixel 3 would be gone on part 0
    place[:] = -50.0  # outside of the image nothing is said
    assert (average_along_tracks(points, cost, place) == cost).all()


def test_labels_keep_to_the_order_unless_they_say_otherwise() -> None:
    points, side = two_frames(), 8
    cost = np.zeros((2 * side, 2))
    cost[:, 1] = np.where(np.arange(2 * side) % side < 4, 3.0, -3.0)
    cost[6] = 0.0, 0.1  # beyond the joint, and not sure of itself
    cost[7] = 0.0, 2.0  # beyond the joint, and folded back
    rank = np.tile(np.linspace(0, 1, side), 2)
    assert assign_labels(points, cost, rank, 0.2)[:side].tolist() == [0, 0, 0, 0, 1, 1, 1, 0]


def test_label_inversions_are_the_share_of_pairs_against_the_chain() -> None:
    rank, frame = np.array([0.1, 0.5, 0.3, 0.9, 0.2, 0.4]), np.array([0, 0, 0, 0, 7, 7])
    assert label_inversions(np.array([0, 2, 1, 2, 1, 1]), rank, frame) == 0.0
    assert label_inversions(np.array([2, 1, 1, 0, 1, 0]), rank, frame) == 6 / 7
    rng = np.random.default_rng(3)
    label, rank, frame = rng.integers(0, 4, 50), rng.random(50), rng.integers(0, 3, 50)
    pairs = [(i, j) for i in range(50) for j in range(50)
             if frame[i] == frame[j] and rank[i] < rank[j]]
    against = [label[i] > label[j] for i, j in pairs]
    assert np.isclose(label_inversions(label, rank, frame), np.mean(against))
