"""The paper's pipeline as it is written: exact matches give exact turns; each step has its row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.benchmark import paper
from gcbench.benchmark.methods import load, with_options
from gcbench.benchmark.results import Row
from gcbench.gcpose.chain import part_motions
from gcbench.gcpose.epipolar import (
    Pair,
    accumulated,
    eight_point,
    pair_of,
    rotations,
    rotations_with_depth,
    sampson,
    shares,
)
from gcbench.gcpose.published import FlowOnly, WithDepth
from gcbench.gcpose.ray_labels import Spots
from gcbench.renderer.observation import Observation
from gcbench.robots.geometry import Array
from scipy.sparse import csr_array

INTRINSICS = np.array([[260.0, 0, 119.5], [0, 260.0, 89.5], [0, 0, 1]])
TIME = np.linspace(0, 1, 8)
DIRECTION = np.array([[0.1, 0.97, 0.22], [0.95, 0.1, 0.3]])
DIRECTION /= np.linalg.norm(DIRECTION, axis=1)[:, None]
AT = np.array([[0.0, 0.3, 1.3], [0.02, -0.05, 1.25]])
TWIST = np.concatenate([DIRECTION, np.cross(AT, DIRECTION)], axis=1)
CHAIN = np.array([-1, 0])
ANGLE = np.stack([0.5 * TIME, -0.6 * TIME**1.3], axis=1)


def body(most: int = 300) -> tuple[Array, np.ndarray]:
    """Points [N 3] of two parts at frame 0, one above the other, and the parts 1, 2."""
    rng = np.random.default_rng(6)
    part = np.repeat([1, 2], most // 2)
    low = np.where(part[:, None] == 1, [-0.15, 0.0, 1.1], [-0.2, -0.3, 1.1])
    return low + rng.random((len(part), 3)) * [0.35, 0.25, 0.3], part


def matched(
    k: int, noise: float = 0.0, span: int = 1
) -> tuple[Spots, np.ndarray, np.ndarray, np.ndarray]:
    """What frames k and k + span show of the body: spots, a flow field, depths and parts."""
    points, part = body()
    motion = part_motions(TWIST, ANGLE, CHAIN)
    here, there = (np.einsum("nij,nj->ni", motion[t, part, :3, :3], points) + motion[t, part, :3, 3]
                   for t in (k, k + span))
    ray, after = here / here[:, 2:], there / there[:, 2:]
    pixel = np.stack([np.arange(len(points)) % 20, np.arange(len(points)) // 20], axis=1)
    flow = np.zeros((20, 20, 2), np.float32)
    rng = np.random.default_rng(k)
    moved = 260.0 * (after - ray)[:, :2] + noise * rng.standard_normal((len(points), 2))
    flow[pixel[:, 1], pixel[:, 0]] = moved
    near = (part[:, None] == part[None]) & (np.abs(points[:, None] - points[None]).max(2) < 0.12)
    found = Spots(np.full(len(part), k), pixel, ray, 1 / here[:, 2], None,
                  csr_array(near.astype(float)), np.zeros((1, *flow.shape[:2]), np.int32))
    return found, flow, 1 / here[:, 2], part


def test_the_sampson_distance_is_that_to_the_nearest_match_which_fits() -> None:
    rng = np.random.default_rng(0)
    found, flow, _, part = matched(0)
    mine = part == 2
    ray = found.ray[mine]
    there = ray.copy()
    there[:, :2] += flow[found.pixel[mine, 1], found.pixel[mine, 0]] / 260.0
    essential = eight_point(ray, there)
    assert np.sqrt(sampson(essential, ray, there)).max() < 1e-5
    assert np.isclose(sampson(7 * essential, ray, there + 0.01).sum(),
                      sampson(essential, ray, there + 0.01).sum())
    off = 1e-3 * rng.standard_normal((len(ray), 2))
    wrong = there.copy()
    wrong[:, :2] += off
    line = ray @ essential.T  # the nearest match that fits moves both ends
    back = wrong @ essential
    normal = np.concatenate([line[:, :2], back[:, :2]], axis=1)
    step = (wrong * line).sum(axis=1) / (normal**2).sum(axis=1)
    nearest = step[:, None] * normal
    fits = sampson(essential, ray - np.pad(nearest[:, 2:], ((0, 0), (0, 1))),
                   wrong - np.pad(nearest[:, :2], ((0, 0), (0, 1))))
    assert np.sqrt(fits).max() < 0.02 * np.sqrt((nearest**2).sum(axis=1)).max()
    assert np.allclose(sampson(essential, ray, wrong), (nearest**2).sum(axis=1))


def test_parts_are_told_apart_and_ordered_from_the_base() -> None:
    found, flow, _, part = matched(0, span=6)
    base = found.ray[part == 1].max(axis=0)
    pair = pair_of(found, flow, INTRINSICS, 2, base)
    assert pair is not None
    assert np.mean(pair.label == part) > 0.95
    assert pair_of(replace(found, frame=found.frame[:5]), flow, INTRINSICS, 2, base) is None


@pytest.mark.parametrize("with_depth", [False, True])
def test_exact_matches_give_exact_angles(with_depth: bool) -> None:
    steps, pairs = [], []
    for k in range(len(TIME) - 1):
        found, flow, depth, part = matched(k)
        pair = pair_of(replace(found, part=part), flow, INTRINSICS, 2, np.zeros(3))
        assert pair is not None and (pair.label == part).all()
        steps.append(rotations_with_depth(pair, depth, 260.0) if with_depth else rotations(pair))
        pairs.append(pair)
    angle = accumulated(steps, shares(pairs, 2), DIRECTION, CHAIN)
    assert np.degrees(np.abs(angle - ANGLE)).max() < 0.2


def test_a_part_that_is_not_seen_is_read_off_what_it_carries() -> None:
    motion = part_motions(TWIST, ANGLE, CHAIN)[:, 1:, :3, :3]
    steps = [list(motion[k + 1] @ motion[k].swapaxes(1, 2)) for k in range(len(TIME) - 1)]
    equal = [np.ones(2)] * len(steps)
    assert np.allclose(accumulated(steps, equal, DIRECTION, CHAIN), ANGLE)
    assert np.allclose(accumulated([[None, r[1]] for r in steps], equal, DIRECTION, CHAIN), ANGLE)
    angle = accumulated([[r[0], None] for r in steps], equal, DIRECTION, CHAIN)
    assert np.allclose(angle[:, 0], ANGLE[:, 0]) and not angle[:, 1].any()
    assert [x.tolist() for x in shares([None], 2)] == [[0, 0]]
    few = Pair(np.zeros((3, 2), int), np.ones((3, 3)), np.ones((3, 3)), np.array([1, 1, 2]),
               np.zeros((2, 3, 3)))
    assert rotations(few) == rotations_with_depth(few, np.ones(3), 1.0) == [None, None]


def slid() -> Observation:
    rgb = np.zeros((3, 40, 40, 3), np.uint8)
    return Observation(rgb, None, INTRINSICS, TIME[:3], 1, ("prismatic",),
                       cam_from_world=np.eye(4), axis_direction=DIRECTION[:1])


def test_what_the_rows_cannot_do_is_said() -> None:
    with pytest.raises(GcbenchError, match="joint 1 slides"):
        FlowOnly().estimate(slid())
    still = FlowOnly().estimate(replace(slid(), joint_types=("revolute",)))
    assert still.displacement.shape == (3, 1) and not still.displacement.any()
    pytest.importorskip("torch", reason="tuning needs PyTorch")
    with pytest.raises(GcbenchError, match="--depth mono:FOLDER"):
        WithDepth().estimate(replace(slid(), joint_types=("revolute",)))
    source = "gcbench.gcpose.published:Epipolar"
    with pytest.raises(GcbenchError, match="no network to tune"):
        load(with_options(source, {"flow": "dis"}))


def test_the_rows_stand_beside_the_paper_s() -> None:
    for method, inputs, name in (
        ("gcpose-flow", "rgb", paper.ALONE), ("gcpose-epipolar", "rgb", paper.EPIPOLAR),
        ("gcpose-depth", "rgb", paper.ESTIMATED), ("gcpose-depth", "rgbd", paper.FULL),
        ("gcpose-depth", "rgbd-noise", paper.NOISY),
    ):
        row = Row(method, "1", inputs, "axes", "none", ())  # type: ignore[arg-type]
        assert paper.counterpart(row, 3) == name
        assert paper.counterpart(replace(row, oracles=("true-flow",)), 3) == ""


def test_tuning_lowers_both_losses_and_leaves_the_network() -> None:
    torch = pytest.importorskip("torch", reason="tuning needs PyTorch")
    from gcbench.gcpose.fine_tune import epipolar_loss, tuned

    class Field:
        """A flow that is its own parameter."""

        rate = 0.05

        def __init__(self) -> None:
            self.network = torch.nn.ParameterList([torch.zeros(1, 2, 20, 20)])

        def tensor(self, a: np.ndarray, b: np.ndarray) -> object:
            return self.network[0] + 0.0

    found, flow, _, part = matched(3, noise=0.5)
    pair = pair_of(replace(found, part=part), flow, INTRINSICS, 2, np.zeros(3))
    assert pair is not None
    image = np.tile(np.linspace(50, 200, 20, dtype=np.uint8)[None, :, None], (20, 1, 3))
    images = np.stack([image, np.roll(image, 1, axis=1)])
    field, inside = Field(), np.ones((2, 20, 20), bool)
    after = tuned(field, images, inside, 260.0, lambda k, f: pair)

    def loss(value: np.ndarray) -> float:
        return float(epipolar_loss(torch.from_numpy(value).permute(2, 0, 1), pair, 260.0))

    assert loss(after[0]) < loss(np.zeros((20, 20, 2), np.float32))
    assert after[0, 2:-2, 2:-2, 0].mean() > 0.02  # towards where the colours are
    assert not field.network[0].any()
