"""Contacts at angles that are known in closed form."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from gcbench.errors import ModelError
from gcbench.robots.geometry import transform
from gcbench.robots.model import (
    ArticulatedModel,
    Joint,
    JointType,
    Link,
    Material,
    Visual,
    forward_kinematics,
)
from gcbench.robots.motion.collision import (
    GROUND,
    CollisionChecker,
    Contact,
    ground_height,
    overlapping_boxes,
)
from gcbench.robots.motion.floor_contact import RigidGroups, rest_poses


def box(part: int, low: tuple[float, ...], high: tuple[float, ...]) -> Visual:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    vertices = np.array(low) + corners * (np.array(high) - np.array(low))
    return Visual(part, vertices, np.array(faces, np.int32), vertices * 0 + [0, 0, 1.0], None,
                  Material())


def tree(parents: list[int], places: list[tuple[float, float, float]], fixed: tuple[int, ...] = (),
         visuals: tuple[Visual, ...] = (), limit: float = np.pi) -> ArticulatedModel:
    """Parts that turn about the y axis through their origins, but the root and the fixed ones."""
    names = [f"p{p}" if p > 7 else "abcdefgh"[p] for p in range(len(parents))]
    links = [Link(names[p], names[parent] if parent >= 0 else None, transform(None, place),
                  Joint() if parent < 0 or p in fixed else
                  Joint(f"j{p}", JointType.REVOLUTE, (0.0, 1.0, 0.0), limits=(-limit, limit)))
             for p, (parent, place) in enumerate(zip(parents, places, strict=True))]
    model = ArticulatedModel.from_links("tree", links, keep_order=True)
    return replace(model, visuals=visuals)


def counted(checker: CollisionChecker) -> list[tuple[int, int]]:
    """The pairs of groups whose contact counts."""
    return [p for p in combinations(checker.groups.surfaces, 2) if p not in checker.ignored]


@pytest.fixture
def doors() -> ArticulatedModel:
    """Two thin doors 1 m long on a root, hinged 1.2 m apart; both stand upright at rest and turn
    towards each other, the one by +q, the other by -q."""
    return tree([-1, 0, 0], [(0, 0, 0), (0, 0, 0.2), (1.2, 0, 0.2)], visuals=(
        box(0, (-0.1, -0.2, 0.0), (1.3, 0.2, 0.1)),
        box(1, (-0.0, -0.1, 0.0), (1e-4, 0.1, 1.0)),
        box(2, (-1e-4, -0.1, 0.0), (0.0, 0.1, 1.0))))


def test_two_doors_meet_at_the_angle_of_the_closed_form(doors: ArticulatedModel) -> None:
    checker = CollisionChecker(doors)
    assert counted(checker) == [(1, 2)]
    meet = np.arcsin(0.6)  # the tips are at sin(q) and 1.2 - sin(q)
    for q, expected in ((meet - 2e-3, False), (meet + 2e-3, True)):
        assert checker.touches(forward_kinematics(doors, [q, -q]), None) is expected
    sweep = np.linspace(0.0, 1.2, 121)
    poses = forward_kinematics(doors, np.stack([sweep, -sweep], axis=1))
    contact = checker.first_contact(poses, None)
    assert contact == Contact(int(np.searchsorted(sweep, meet)), "b", "c")
    assert checker.first_contact(poses[:60], None) is None


def test_parts_that_a_joint_joins_may_overlap(doors: ArticulatedModel) -> None:
    checker = CollisionChecker(doors)
    assert not checker.touches(forward_kinematics(doors, [np.pi, 0.0]), None)  # into its own root
    shifted = transform(None, [3.0, -2.0, 1.0])
    assert not checker.touches(shifted @ forward_kinematics(doors, [np.pi, 0.0]), None)


def test_a_joined_part_without_a_surface_is_looked_through() -> None:
    # a - b (no surface) - c: c's box lies in a's
    model = tree([-1, 0, 1], [(0, 0, 0)] * 3,
                 visuals=(box(0, (-1, -1, -1), (1, 1, 0)), box(2, (0, 0, -0.5), (0.2, 0.2, 0.5))))
    assert counted(CollisionChecker(model)) == []


def test_pairs_that_touch_at_rest_or_always_do_not_count() -> None:
    base = box(0, (-0.1, -0.1, 0.0), (0.1, 0.1, 0.1))
    arms = (box(1, (0, 0, 0), (1, 0.1, 0.1)), box(2, (0, 0, 0), (1, 0.1, 0.1)))
    overlapping = tree([-1, 0, 0], [(0, 0, 0), (0, 0, 1), (0.5, 0.05, 1.05)],
                       visuals=(base, *arms))
    assert counted(CollisionChecker(overlapping)) == []
    apart = replace(overlapping, parent_from_part_at_zero=transform(
        None, np.array([[0, 0, 0], [0, 0, 1], [0, 0.05, 1.3]])))  # apart at rest, else they cross
    assert counted(CollisionChecker(apart)) == [(1, 2)]
    # two bars through points 2 cm apart: parallel at rest, crossing at nearly any other angles
    bar = ((-1, 0, -0.005), (1, 0.1, 0.005))
    bars = replace(overlapping, visuals=(base, box(1, *bar), box(2, *bar)),
                   parent_from_part_at_zero=transform(
                       None, np.array([[0, 0, 0], [0, 0, 2], [0, 0, 2.02]])))
    assert not set(counted(CollisionChecker(bars))) & {(1, 2)}


def test_fixed_joints_make_one_body() -> None:
    model = tree([-1, 0, 1, 2, 0], [(0, 0, 0), (0, 0, 1), (0.5, 0, 0), (0.5, 0, 0), (3, 0, 1)],
                 fixed=(2, 3), visuals=tuple(box(p, (0, 0, 0), (0.3, 0.1, 0.1))
                                             for p in range(5)))
    groups = RigidGroups(model)
    assert groups.group.tolist() == [0, 1, 1, 1, 4]
    assert counted(CollisionChecker(model)) == [(1, 4)]
    vertices, faces = groups.surfaces[1]
    assert vertices.min(0).tolist() == [0, 0, 0]
    np.testing.assert_allclose(vertices.max(0), [1.3, 0.1, 0.1])
    assert faces.max() == len(vertices) - 1


def test_only_moving_parts_touch_the_ground_and_only_below_it() -> None:
    # an arm 1 m long on a post of 0.5 m: its tip reaches the ground at 30 degrees down
    model = tree([-1, 0], [(0, 0, 0), (0, 0, 0.5)], limit=1.0, visuals=(
        box(0, (-0.1, -0.1, 0.0), (0.1, 0.1, 0.4)), box(1, (0, -0.05, 0), (1, 0.05, 1e-4))))
    checker = CollisionChecker(model)
    poses = forward_kinematics(model, np.deg2rad([[0.0], [29.8], [30.3]]))
    floor = ground_height(model, poses)
    assert floor == 0.0 == checker.ground_height(poses)
    assert checker.first_contact(poses, floor) == Contact(2, "b", GROUND)
    assert checker.first_contact(poses, None) is None
    assert not checker.touches(poses[0], 0.2)  # what stands in the ground does not touch it
    assert checker.touches(poses[0], 0.6)


def test_an_arm_stands_on_its_foot_although_it_hangs_lower_at_rest() -> None:
    model = tree([-1, 0], [(0, 0, 0), (0, 0, 0.3)], visuals=(
        box(0, (-0.1, -0.1, 0.0), (0.1, 0.1, 0.2)), box(1, (0, 0.2, -1), (0.1, 0.3, 0))))
    assert ground_height(model, forward_kinematics(model, [[0.0], [1.0]])) == 0.0
    raised = transform(None, [0, 0, 2.0]) @ forward_kinematics(model, [[0.0], [1.0]])
    assert ground_height(model, raised) == pytest.approx(2.0)


def test_legs_stand_on_the_lowest_point_that_they_reach() -> None:
    model = tree([-1, 0], [(0, 0, 0), (0, 0, 0)], limit=0.5, visuals=(
        box(0, (-0.5, -0.5, 0.0), (0.5, 0.5, 0.2)), box(1, (0, 0, -1), (0, 0, 0))))
    poses = forward_kinematics(model, [[0.3], [0.5]])
    floor = ground_height(model, poses)
    assert floor == pytest.approx(-np.cos(0.3))
    assert not CollisionChecker(model).first_contact(poses, floor)
    # a root without a surface cannot be stood on either
    assert ground_height(replace(model, visuals=model.visuals[1:]), poses) == floor
    assert ground_height(replace(model, visuals=()), poses) == 0.0


def test_a_model_without_surface_or_joints_is_never_in_contact() -> None:
    bare = tree([-1, 0], [(0, 0, 0), (0, 0, 1)])
    assert not CollisionChecker(bare).touches(forward_kinematics(bare, [0.3]), 5.0)
    still = tree([-1], [(0, 0, 0)], visuals=(box(0, (0, 0, 0), (1, 1, 1)),))
    checker = CollisionChecker(still)
    assert counted(checker) == [] and not checker.touches(rest_poses(still), 0.5)


def test_building_twice_gives_the_same_pairs(doors: ArticulatedModel) -> None:
    assert CollisionChecker(doors).ignored == CollisionChecker(doors).ignored


def test_overlapping_boxes_are_those_of_all_pairs() -> None:
    rng = np.random.default_rng(0)
    for spread in (0.5, 2.0, 20.0):
        low = rng.uniform(0.0, spread, (60, 3))
        high = low + rng.uniform(0.0, 1.0, (60, 3))
        expected = [(a, b) for a, b in combinations(range(60), 2)
                    if (low[a] <= high[b]).all() and (low[b] <= high[a]).all()]
        assert [*map(tuple, overlapping_boxes(low, high).tolist())] == expected
    assert overlapping_boxes(low[:1], high[:1]).shape == (0, 2)


def test_a_long_chain_is_prepared_in_seconds() -> None:
    count = 600  # 180,000 pairs, in 51 poses
    chain = tree([*range(-1, count - 1)], [(0, 0, 0), *[(0, 0, 0.06)] * (count - 1)], limit=1.0,
                 visuals=tuple(box(p, (0, 0, 0), (0.02, 0.02, 0.05)) for p in range(count)))
    start = time.process_time()
    CollisionChecker(chain)
    assert time.process_time() - start < 20.0  # 2 s; a test of each pair took 140 s


def test_a_heap_of_bodies_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    heap = tree([-1, *[0] * 40], [(0, 0, 0)] * 41,
                visuals=tuple(box(p, (0, 0, 0), (1, 1, 1 + p)) for p in range(41)))
    assert CollisionChecker(heap).ignored
    monkeypatch.setattr("gcbench.robots.motion.collision.MAX_TESTS", 700)
    with pytest.raises(ModelError, match="tree: more than 700 pairs of its 41 moving bodies"):
        CollisionChecker(heap)
