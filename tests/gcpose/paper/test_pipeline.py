"""The paper's pipeline as it is written: exact matches give exact turns; each step has its row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.benchmark.methods.registry import load_method, with_options
from gcbench.benchmark.report import published_numbers as paper
from gcbench.benchmark.results.rows import Row
from gcbench.gcpose.chain.kinematics import part_motions
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.paper.epipolar import (
    MatchedParts,
    PartMatcher,
    accumulate_angles,
    eight_point,
    joint_orders,
    rotations,
    rotations_with_depth,
    sampson_distance,
)
from gcbench.gcpose.paper.pipeline import FlowOnly, WithDepth
from gcbench.gcpose.paper.settings import PaperSettings
from gcbench.gcpose.rgb.labels import SampledPixels
from gcbench.gcpose.rgb.outline import Outline
from gcbench.renderer.types.observation import Observation
from gcbench.robots.geometry import Array, rotation_about
from gcbench.robots.motion import ChainAxes, chain_rotations
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_array

INTRINSICS = np.array([[260.0, 0, 119.5], [0, 260.0, 89.5], [0, 0, 1]])
TIME = np.linspace(0, 1, 8)
DIRECTION = np.array([[0.1, 0.97, 0.22], [0.95, 0.1, 0.3]])
DIRECTION /= np.linalg.norm(DIRECTION, axis=1)[:, None]
AT = np.array([[0.0, 0.3, 1.3], [0.02, -0.05, 1.25]])
TWIST = np.concatenate([DIRECTION, np.cross(AT, DIRECTION)], axis=1)
CHAIN = np.array([-1, 0])
SETTINGS = PaperSettings()
MATCHER = PartMatcher(260.0, 2, SETTINGS, ImageSettings())
ANGLE = np.stack([0.5 * TIME, -0.6 * TIME**1.3], axis=1)


def body(most: int = 300) -> tuple[Array, np.ndarray]:
    """Points [N 3] of two parts at frame 0, one above the other, and the parts 1, 2."""
    rng = np.random.default_rng(6)
    part = np.repeat([1, 2], most // 2)
    low = np.where(part[:, None] == 1, [-0.15, 0.0, 1.1], [-0.2, -0.3, 1.1])
    return low + rng.random((len(part), 3)) * [0.35, 0.25, 0.3], part


def match_exactly(
    k: int, noise: float = 0.0, span: int = 1
) -> tuple[SampledPixels, np.ndarray, np.ndarray, np.ndarray]:
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
    found = SampledPixels(np.full(len(part), k), pixel, ray, 1 / here[:, 2], None,
                          Outline.none(len(part)), csr_array(near.astype(float)),
                          np.zeros((1, *flow.shape[:2]), np.int32))
    return found, flow, 1 / here[:, 2], part


def test_the_sampson_distance_is_that_to_the_nearest_match_which_fits() -> None:
    rng = np.random.default_rng(0)
    found, flow, _, part = match_exactly(0)
    mine = part == 2
    ray = found.ray[mine]
    there = ray.copy()
    there[:, :2] += flow[found.pixel[mine, 1], found.pixel[mine, 0]] / 260.0
    essential = eight_point(ray, there)
    assert np.abs(sampson_distance(essential, ray, there)).max() < 1e-5
    assert np.allclose(sampson_distance(7 * essential, ray, there + 0.01),
                       sampson_distance(essential, ray, there + 0.01))
    off = 1e-3 * rng.standard_normal((len(ray), 2))
    wrong = there.copy()
    wrong[:, :2] += off
    line = ray @ essential.T  # the nearest match that fits moves both ends
    back = wrong @ essential
    normal = np.concatenate([line[:, :2], back[:, :2]], axis=1)
    step = (wrong * line).sum(axis=1) / (normal**2).sum(axis=1)
    nearest = step[:, None] * normal
    fits = sampson_distance(essential, ray - np.pad(nearest[:, 2:], ((0, 0), (0, 1))),
                            wrong - np.pad(nearest[:, :2], ((0, 0), (0, 1))))
    assert np.abs(fits).max() < 0.02 * np.sqrt((nearest**2).sum(axis=1)).max()
    assert np.allclose(sampson_distance(essential, ray, wrong) ** 2, (nearest**2).sum(axis=1))


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.1, 10))
def test_the_sampson_distance_has_no_scale_and_no_direction(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    essential = rng.standard_normal((3, 3))
    ray, there = (np.column_stack([rng.standard_normal((5, 2)), np.ones(5)]) for _ in range(2))
    distance = sampson_distance(essential, ray, there)
    line, back = ray @ essential.T, there @ essential
    square = (line[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)
    assert np.allclose(distance * np.sqrt(square), np.einsum("ni,ni->n", there, line))
    assert np.allclose(sampson_distance(scale * essential, ray, there), distance)
    assert np.allclose(sampson_distance(essential.T, there, ray), distance)
    each = np.repeat(essential[None], 5, axis=0)
    assert np.allclose(sampson_distance(each, ray, there), distance)


def test_a_tensor_has_the_same_sampson_distance() -> None:
    torch = pytest.importorskip("torch", reason="tuning needs PyTorch")
    rng = np.random.default_rng(1)
    arrays = rng.standard_normal((3, 3)), rng.random((7, 3)), rng.random((7, 3))
    tensors = [torch.from_numpy(a) for a in arrays]
    assert np.allclose(sampson_distance(*tensors).numpy(), sampson_distance(*arrays))


def test_parts_are_told_apart_and_ordered_from_the_base() -> None:
    found, flow, _, part = match_exactly(0, span=6)
    base = found.ray[part == 1].max(axis=0)
    pair = MATCHER.match(found, base, flow)
    assert pair is not None
    assert np.mean(pair.label == part) > 0.95
    assert MATCHER.match(replace(found, frame=found.frame[:5]), base, flow) is None


@pytest.mark.parametrize("with_depth", [False, True])
def test_exact_matches_give_exact_angles(with_depth: bool) -> None:
    steps, pairs, axes = [], [], ChainAxes(DIRECTION, np.zeros(2, bool), CHAIN)
    for k in range(len(TIME) - 1):
        found, flow, depth, part = match_exactly(k)
        pair = MATCHER.match(replace(found, part=part), np.zeros(3), flow)
        assert pair is not None and (pair.label == part).all()
        steps.append(rotations_with_depth(pair, depth, 260.0, SETTINGS) if with_depth
                     else rotations(pair, SETTINGS))
        pairs.append(pair)
    angle, _ = accumulate_angles(pairs, steps, axes, [np.arange(2)], SETTINGS)
    assert np.degrees(np.abs(angle - ANGLE)).max() < 0.2
    free = accumulate_angles(pairs, steps, axes, joint_orders(2, 2), SETTINGS)[0]
    assert np.allclose(angle, free)


def test_the_chain_tells_whose_a_turn_is() -> None:
    """One that is not seen is read off what it carries; what is none is left out."""
    chain = ChainAxes(np.eye(3)[[2, 0, 1]], np.zeros(3, bool), np.array([-1, 0, 1]))
    time = TIME[:, None] * [0.4, -0.3, 0.35]
    turn = chain_rotations(chain, time[0])
    steps = []
    for angle in time[1:]:
        before, turn = turn, chain_rotations(chain, angle)
        steps.append(list(turn @ before.swapaxes(1, 2)))
    some = MatchedParts(np.zeros((9, 2), int), np.ones((9, 3)), np.ones((9, 3)),
                        np.repeat([1, 2, 3], 3),
                np.zeros((3, 3, 3)))
    pairs, axes = [some] * len(steps), chain
    known, free = [np.arange(3)], joint_orders(3, 2)
    assert np.allclose(accumulate_angles(pairs, steps, axes, known, SETTINGS)[0], time)
    unseen = [[None, *s[1:]] for s in steps]
    assert np.allclose(accumulate_angles(pairs, unseen, axes, known, SETTINGS)[0], time)
    last = accumulate_angles(pairs, [[*s[:2], None] for s in steps], axes, known, SETTINGS)[0]
    assert np.allclose(last[:, :2], time[:, :2]) and not last[:, 2].any()
    away = np.asarray(rotation_about([0.6, 0.8, 0], 0.5))
    shifted = [[away, s[1], s[2]] for s in steps]  # the first part is none
    angle, joint = accumulate_angles(pairs, shifted, axes, free, SETTINGS)
    assert np.abs(angle - time).max() < 1e-6
    assert all(j.tolist() == [-1, 1, 2] for j in joint)
    angle, _ = accumulate_angles([None] * len(steps), steps, axes, free, SETTINGS)
    assert not angle.any()


def test_parts_keep_their_order() -> None:
    found = {tuple(x.tolist()) for x in joint_orders(3, 2)}
    assert len(found) == len(joint_orders(3, 2)) == 19  # but for none at all
    assert (0, 1, 2) in found and (-1, 0, 2) in found and (1, 0, 2) not in found
    many = joint_orders(7, 2)
    assert len(many) == 21**2 + 7**2 + 1 and many[0].tolist() == list(range(7))
    few = MatchedParts(np.zeros((3, 2), int), np.ones((3, 3)), np.ones((3, 3)), np.array([1, 1, 2]),
               np.zeros((2, 3, 3)))
    assert rotations(few, SETTINGS) == [None, None]
    assert rotations_with_depth(few, np.ones(3), 1.0, SETTINGS) == [None, None]


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
    source = "gcbench.gcpose.paper.pipeline:Epipolar"
    with pytest.raises(GcbenchError, match="no network to tune"):
        load_method(with_options(source, {"flow": "dis"}))


def test_settings_change_a_row_s_name() -> None:
    source = with_options("gcbench.gcpose.paper.pipeline:FlowOnly", {"set": "paper.max_points=90"})
    assert load_method(source).name == "gcpose-flow paper.max_points=90"


def test_the_rows_stand_beside_the_paper_s() -> None:
    for method, inputs, name in (
        ("gcpose-flow", "rgb", paper.ALONE), ("gcpose-epipolar", "rgb", paper.EPIPOLAR),
        ("gcpose-depth", "rgb", paper.ESTIMATED), ("gcpose-depth", "rgbd", paper.FULL),
        ("gcpose-depth", "rgbd-noise", paper.NOISY),
    ):
        row = Row(method, "1", inputs, "axes", "none", ())  # type: ignore[arg-type]
        assert paper.counterpart(row, 3, "ur5") == name
        assert paper.counterpart(replace(row, oracles=("true-flow",)), 3, "ur5") == ""


def test_tuning_lowers_both_losses_and_leaves_the_network() -> None:
    torch = pytest.importorskip("torch", reason="tuning needs PyTorch")
    from gcbench.gcpose.paper.fine_tune import epipolar_loss, tune_flow

    class Field:
        """A flow that is its own parameter."""

        rate = 0.05

        def __init__(self) -> None:
            self.network = torch.nn.ParameterList([torch.zeros(1, 2, 20, 20)])

        def tensor(self, a: np.ndarray, b: np.ndarray) -> object:
            return self.network[0] + 0.0

    found, flow, _, part = match_exactly(3, noise=0.5)
    pair = MATCHER.match(replace(found, part=part), np.zeros(3), flow)
    assert pair is not None
    image = np.tile(np.linspace(50, 200, 20, dtype=np.uint8)[None, :, None], (20, 1, 3))
    images = np.stack([image, np.roll(image, 1, axis=1)])
    field, inside = Field(), np.ones((2, 20, 20), bool)
    after = tune_flow(field, images, inside, 260.0, lambda k, f: pair, SETTINGS)

    def loss(value: np.ndarray) -> float:
        return float(epipolar_loss(torch.from_numpy(value).permute(2, 0, 1), pair, 260.0))

    assert loss(after[0]) < loss(np.zeros((20, 20, 2), np.float32))
    assert after[0, 2:-2, 2:-2, 0].mean() > 0.02  # towards where the colours are
    assert not field.network[0].any()
