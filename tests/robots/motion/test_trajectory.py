"""Random motions: the protocol's numbers hold for every seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.robots.model import ArticulatedModel, Joint, JointType, Link, Material, Visual
from gcbench.robots.motion.trajectory import (
    MotionRanges,
    base_outward,
    default_scored_joints,
    joint_indices,
    joint_window,
    sample_trajectory,
)

JOINTS = {
    "wide": ("revolute", -2 * np.pi, 2 * np.pi),
    "narrow": ("revolute", -0.1, 0.05),
    "offset": ("revolute", 0.5, 2.5),
    "free": ("continuous", -np.inf, np.inf),
    "one-sided": ("revolute", 1.0, np.inf),
    "drawer": ("prismatic", 0.0, 0.4),
    "long": ("prismatic", -1.0, 3.0),
    "short": ("prismatic", 0.0, 0.02),
    "endless": ("prismatic", -np.inf, np.inf),
    "stuck": ("revolute", 0.3, 0.3),
}
NAMES = tuple(JOINTS)


def chain(names: tuple[str, ...] = NAMES) -> ArticulatedModel:
    """A root and one part per joint, in a row; a triangle on each part."""
    triangle = np.eye(3)
    links = [Link("root"), *(
        Link(name, parent, joint=Joint(name, JointType(JOINTS[name][0]), limits=JOINTS[name][1:]))
        for name, parent in zip(names, ("root", *names), strict=False))]
    return replace(
        ArticulatedModel.from_links("chain", links),
        visuals=tuple(Visual(p, triangle, np.array([[0, 1, 2]], np.int32), triangle, None,
                             Material()) for p in range(len(links))))


@pytest.mark.parametrize("frames", [1, 2, 3, 5, 15, 40])
def test_every_frame_is_within_the_limits(frames: int) -> None:
    model = chain()
    for seed in range(100):
        q = sample_trajectory(model, NAMES, frames, rng=np.random.default_rng(seed)).positions
        assert q.shape == (frames, len(NAMES)) and np.isfinite(q).all()
        assert (q >= model.limits[:, 0]).all() and (q <= model.limits[:, 1]).all()
        for j, name in enumerate(NAMES):
            low, high = joint_window(model, j)
            assert low <= q[:, j].min() and q[:, j].max() <= high
            assert high - low <= (4.0 if JOINTS[name][0] == "prismatic" else 2 * np.pi + 1e-12)


def test_totals_and_steps_follow_the_protocol() -> None:
    model = chain()
    rooms = [NAMES.index(name) for name in ("wide", "offset", "free", "one-sided")]
    totals: list[np.ndarray] = []
    for seed in range(300):
        q = sample_trajectory(model, NAMES, 15, rng=np.random.default_rng(seed)).positions
        revolute = [j for j, name in enumerate(NAMES) if JOINTS[name][0] != "prismatic"]
        assert np.abs(np.diff(q, axis=0))[:, revolute].max() <= np.deg2rad(6.0) + 1e-12
        totals.append(np.rad2deg(q[-1] - q[0])[rooms])
    all_totals = np.concatenate(totals)
    size = np.abs(all_totals)
    assert size.min() >= 10 - 1e-9 and size.max() <= 70 + 1e-9
    assert abs(size.mean() - 40) < 2 and size.min() < 11 and size.max() > 69  # uniform
    assert abs((all_totals > 0).mean() - 0.5) < 0.05


def test_speed_and_direction_are_not_to_be_guessed() -> None:
    q = [sample_trajectory(chain(("wide",)), ("wide",), 15, rng=np.random.default_rng(s)).positions
         for s in range(200)]
    steps = np.diff(np.stack(q)[..., 0], axis=1)
    unevenness = steps.std(axis=1) / np.abs(steps.mean(axis=1))
    assert np.median(unevenness) > 0.15
    assert (np.sign(steps[:, 0]) != np.sign(steps.mean(axis=1))).any()  # some turn back


def test_motion_is_smooth() -> None:
    for seed in range(100):
        q = sample_trajectory(chain(("wide",)), ("wide",), 60,
                              rng=np.random.default_rng(seed)).positions[:, 0]
        speed = np.diff(q)
        assert np.abs(np.diff(speed)).max() <= 0.25 * np.abs(speed).max() + 1e-12


@pytest.mark.parametrize("frames", [2, 3, 4])
def test_few_frames_move_less_not_faster(frames: int) -> None:
    for seed in range(50):
        q = sample_trajectory(chain(("wide",)), ("wide",), frames,
                              rng=np.random.default_rng(seed)).positions[:, 0]
        assert 0 < np.abs(np.diff(q)).max() <= np.deg2rad(6.0) + 1e-12


def test_prismatic_joints_move_a_share_of_their_range() -> None:
    model = chain()
    drawer, long, short, endless = (NAMES.index(n) for n in ("drawer", "long", "short", "endless"))
    size = np.array([np.abs(np.subtract(*sample_trajectory(
        model, NAMES, 15, rng=np.random.default_rng(s)).positions[[0, -1]])) for s in range(200)])
    assert size[:, drawer].min() >= 0.04 - 1e-12 and size[:, drawer].max() <= 0.36 + 1e-12
    assert size[:, long].min() >= 0.4 - 1e-12 and size[:, long].max() <= 3.6 + 1e-12
    assert size[:, endless].min() >= 0.1 - 1e-12 and size[:, endless].max() <= 0.9 + 1e-12
    assert size[:, short].min() > 0.008  # all that its range gives, less the way back


def test_a_small_range_still_gives_three_centimetres() -> None:
    model = replace(chain(("drawer",)), limits=np.array([[0.0, 0.1]]))  # 10 % would be 1 cm
    for seed in range(100):
        rng = np.random.default_rng(seed)
        q = sample_trajectory(model, ("drawer",), 15, rng=rng).positions[:, 0]
        assert abs(q[-1] - q[0]) >= 0.03 * 0.99


def test_other_joints_hold_a_pose_that_scoring_does_not_change() -> None:
    model = chain()
    one = sample_trajectory(model, ("wide",), 15, rng=np.random.default_rng(3)).positions
    two = sample_trajectory(model, ("wide", "free"), 15, rng=np.random.default_rng(3)).positions
    assert (one[:, 1:] == one[0, 1:]).all() and np.ptp(one[:, 0]) > 0
    others = [j for j, name in enumerate(NAMES) if name != "free"]
    np.testing.assert_array_equal(one[:, others], two[:, others])
    poses = np.array([sample_trajectory(model, (), 1, rng=np.random.default_rng(s)).positions[0]
                      for s in range(500)])
    assert abs(poses[:, 0].mean()) < 0.3 and np.ptp(poses[:, 0]) > 6.0  # all of +-pi is used
    assert (poses[:, NAMES.index("stuck")] == 0.3).all()


def test_the_same_generator_gives_the_same_motion() -> None:
    def draw(seed: int) -> np.ndarray:
        return sample_trajectory(chain(), NAMES, 15, rng=np.random.default_rng(seed)).positions

    np.testing.assert_array_equal(draw(5), draw(5))
    assert (draw(5) != draw(6)).any()


def test_times_are_seconds() -> None:
    times = sample_trajectory(chain(), NAMES, 4, MotionRanges(fps=10.0),
                              rng=np.random.default_rng(0)).times
    np.testing.assert_allclose(times, [0, 0.1, 0.2, 0.3])


def test_joints_are_ordered_from_the_base_outward() -> None:
    model = chain(("wide", "free", "offset"))
    # two branches: wide - free, and offset straight on the root
    model = replace(model, parent=np.array([-1, 0, 1, 0]))
    assert base_outward(model).tolist() == [0, 2, 1]
    assert joint_indices(model, ("free", "offset")).tolist() == [2, 1]
    assert default_scored_joints(model, 2) == ("wide", "offset")
    bare = replace(model, visuals=tuple(v for v in model.visuals if v.part != 3))
    assert default_scored_joints(bare, 2) == ("wide", "free")
    mimicked = replace(bare, joint=np.array([-1, 0, 2, 2]))
    assert "offset" in default_scored_joints(mimicked, 3)  # it moves what mimics it


def test_unknown_joints_and_no_frames_are_one_line() -> None:
    with pytest.raises(GcbenchError, match="wide, narrow"):
        sample_trajectory(chain(), ("elbow",), 15, rng=np.random.default_rng(0))
    with pytest.raises(GcbenchError, match="at least 1 frame"):
        sample_trajectory(chain(), NAMES, 0, rng=np.random.default_rng(0))


def test_small_and_stuck_joints_are_not_scored_while_others_are_there() -> None:
    model = chain(("wide", "free", "offset"))
    model = replace(model, parent=np.array([-1, 0, 0, 0]))  # three branches on the root
    assert default_scored_joints(model, 3) == ("wide", "free", "offset")
    shrunk = tuple(
        replace(v, vertices=v.vertices * 0.01) if v.part == 1 else v for v in model.visuals
    )
    assert default_scored_joints(replace(model, visuals=shrunk), 3) == ("free", "offset")
    stuck = replace(model, limits=np.array([[0.0, 0.0]] * 3))
    assert default_scored_joints(stuck, 3) == ("wide", "free", "offset")  # nothing better is there
