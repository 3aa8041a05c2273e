"""Laws of motion: forward kinematics, screws, mimics."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest
from gcbench.errors import ModelError
from gcbench.robots.geometry import (
    inverse,
    revolute_motion,
    rotation_about,
    rotation_from_rpy,
    transform,
)
from gcbench.robots.model import (
    ArticulatedModel,
    Joint,
    JointType,
    Link,
    Mimic,
    forward_kinematics,
    joint_screws,
)
from gcbench.robots.urdf.reader import load_urdf
from hypothesis import given
from hypothesis import strategies as st

CHAIN = """<robot name="chain">
  <link name="c"/><link name="a"/><link name="b"/><link name="d"/><link name="e"/>
  <joint name="ab" type="revolute"><parent link="a"/><child link="b"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.3 -0.4 0.5"/><axis xyz="0 3 4"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="bc" type="prismatic"><parent link="b"/><child link="c"/>
    <origin xyz="0 0 1"/><axis xyz="0 0 2"/><limit lower="0" upper="0.5"/></joint>
  <joint name="cd" type="continuous"><parent link="c"/><child link="d"/>
    <origin xyz="0.5 0 0" rpy="0 1 0"/></joint>
  <joint name="de" type="fixed"><parent link="d"/><child link="e"/>
    <origin xyz="0 0.25 0"/><axis xyz="0 0 0"/></joint>
</robot>"""


def model_of(tmp_path: Path, text: str) -> ArticulatedModel:
    path = tmp_path / "model.urdf"
    path.write_text(text)
    return load_urdf(path)


def mimic(name: str, parent: str, child: str, rule: str = "") -> str:
    return (f'<link name="{child}"/><joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="0 0 1"/><limit lower="-3" upper="3"/>{rule}'
            "</joint>")


def test_parents_stand_before_children_and_joints_keep_their_order(tmp_path: Path) -> None:
    m = model_of(tmp_path, CHAIN)
    assert m.part_names == ("a", "b", "c", "d", "e")
    assert (m.parent < np.arange(5)).all() and m.parent[0] == -1
    assert m.joint_names == ("ab", "bc", "cd")
    assert m.joint_types == ("revolute", "prismatic", "continuous")
    assert [m.part_names[p] for p in m.joint_child] == ["b", "c", "d"]
    np.testing.assert_array_equal(m.limits, [[-2, 2], [0, 0.5], [-np.inf, np.inf]])
    np.testing.assert_allclose(m.screw[1], [0, 0.6, 0.8, 0, 0, 0])
    np.testing.assert_allclose(m.screw[3, :3], [1, 0, 0])  # the default axis
    assert m.part_joint_types[4] is JointType.FIXED


def test_moving_one_joint_is_a_motion_about_its_screw(tmp_path: Path) -> None:
    m = model_of(tmp_path, CHAIN)
    q = np.array([0.4, 0.2, -0.7])
    before = forward_kinematics(m, q)
    screws = joint_screws(m, before)
    for j, step in enumerate([0.9, 0.1, -1.3]):
        moved = q.copy()
        moved[j] += step
        after = forward_kinematics(m, moved)
        motion = after @ inverse(before)
        hangs = m.subtree(int(m.joint_child[j]))
        np.testing.assert_allclose(motion[~hangs], np.broadcast_to(np.eye(4), motion[~hangs].shape),
                                   atol=1e-12)
        if m.joint_types[j] == "prismatic":
            expected = np.eye(4)
            expected[:3, 3] = screws[j, :3] * step
        else:
            expected = revolute_motion(screws[j], step)
        np.testing.assert_allclose(motion[hangs],
                                   np.broadcast_to(expected, motion[hangs].shape), atol=1e-12)


def test_screws_obey_the_contract(tmp_path: Path) -> None:
    m = model_of(tmp_path, CHAIN)
    s = joint_screws(m, forward_kinematics(m, [0.1, 0.2, 0.3]))
    np.testing.assert_allclose(np.linalg.norm(s[:, :3], axis=1), 1.0)
    np.testing.assert_allclose(np.einsum("ji,ji->j", s[:, :3], s[:, 3:]), 0.0, atol=1e-15)
    np.testing.assert_array_equal(s[1, 3:], 0.0)


def test_kinematics_is_vectorised_over_time(tmp_path: Path) -> None:
    m = model_of(tmp_path, CHAIN)
    q = np.random.default_rng(1).normal(size=(3, 2, 3))
    whole = forward_kinematics(m, q)
    for i in np.ndindex(3, 2):
        np.testing.assert_array_equal(whole[i], forward_kinematics(m, q[i]))


def test_kinematics_agrees_with_yourdfpy(tmp_path: Path) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    m = model_of(tmp_path, CHAIN.replace("0 0 2", "0 0 1"))  # it does not make axes unit vectors
    other = yourdfpy.URDF.load(str(tmp_path / "model.urdf"), load_meshes=False)
    q = np.array([0.3, 0.1, -2.0])
    other.update_cfg(dict(zip(m.joint_names, q, strict=True)))
    for pose, name in zip(forward_kinematics(m, q), m.part_names, strict=True):
        np.testing.assert_allclose(pose, other.get_transform(name, "a"), atol=1e-12)


def test_a_mimic_of_a_mimic_follows_through(tmp_path: Path) -> None:
    text = ('<robot name="r"><link name="l0"/>'
            + mimic("third", "l2", "l3", '<mimic joint="second" multiplier="2" offset="0.1"/>')
            + mimic("first", "l0", "l1")
            + mimic("second", "l1", "l2", '<mimic joint="first" multiplier="-0.5" offset="0.3"/>')
            + "</robot>")
    m = model_of(tmp_path, text)
    assert m.joint_names == ("first",)
    q = 0.7
    second = -0.5 * q + 0.3
    third = 2 * second + 0.1
    np.testing.assert_allclose(m.multiplier[1:], [1, -0.5, -1])
    angle = q + second + third  # all axes are z
    pose = forward_kinematics(m, [q])[3]
    np.testing.assert_allclose(np.arctan2(pose[1, 0], pose[0, 0]), angle)
    assert m.part_names[m.joint_child[0]] == "l1"


def test_a_multiplier_of_zero_freezes_the_part_at_its_offset(tmp_path: Path) -> None:
    text = ('<robot name="r"><link name="l0"/>' + mimic("first", "l0", "l1")
            + mimic("still", "l0", "l2", '<mimic joint="first" multiplier="0" offset="0.25"/>')
            + mimic("after", "l0", "l3", '<mimic joint="still" multiplier="2" offset="0.1"/>')
            + "</robot>")
    m = model_of(tmp_path, text)
    assert m.joint_names == ("first",)
    for q in (0.0, 1.0):
        poses = forward_kinematics(m, [q])
        np.testing.assert_allclose(np.arctan2(poses[2:, 1, 0], poses[2:, 0, 0]), [0.25, 0.6])
    assert set(m.part_joint_types[2:]) == {"fixed"} and (m.joint[2:] == -1).all()
    assert sum("frozen" in note for note in m.notes) == 2


@pytest.mark.parametrize(("rule", "limits", "expected"), [
    (Mimic("a", 5.0), (-0.1, 0.1), (-0.02, 0.02)), (Mimic("a", -2.0, 1.0), (0.0, 2.0), (-0.5, 0.5)),
    (Mimic("a"), (-9.0, 9.0), (-1.5, 1.5)), (Mimic("a"), (-1.5000001, 1.4999999), (-1.5, 1.5)),
    (Mimic("a"), (0.0, 0.0), None), (Mimic("a"), (3.0, 4.0), None),
])
def test_a_joint_stays_within_the_limits_of_those_that_mimic_it(
    rule: Mimic, limits: tuple[float, float], expected: tuple[float, float] | None
) -> None:
    turns = JointType.REVOLUTE
    model = ArticulatedModel.from_links("arm", [
        Link("base"), Link("one", "base", joint=Joint("a", turns, limits=(-1.5, 1.5))),
        Link("two", "one", joint=Joint("b", turns, limits=limits, mimic=rule)),
        Link("three", "two", joint=Joint("c", turns, limits=limits, mimic=Mimic("b")))])
    np.testing.assert_allclose(model.limits, [expected or (-1.5, 1.5)], rtol=1e-12)
    assert len(model.notes) == (0 if expected else 2)
    assert all("could not move within them" in note for note in model.notes)


def arm(mimics: dict[str, Mimic | None]) -> ArticulatedModel:
    """Hinges on one base, by name."""
    return ArticulatedModel.from_links("arm", [Link("base"), *(
        Link(f"link {name}", "base", joint=Joint(name, JointType.REVOLUTE, mimic=mimic))
        for name, mimic in mimics.items())])


@pytest.mark.parametrize(("mimics", "reason"), [
    ({"a": Mimic("b"), "b": Mimic("a")}, "cycle: a -> b -> a"),
    ({"a": Mimic("a")}, "cycle: a -> a"),
    ({"a": Mimic("z"), "b": None}, r"'z'.*there are a, b"),
])
def test_mimics_in_a_cycle_or_of_no_joint_are_refused(
    mimics: dict[str, Mimic | None], reason: str
) -> None:
    with pytest.raises(ModelError, match=reason):
        arm(mimics)


@pytest.mark.parametrize(("links", "reason"), [
    ([Link("a"), Link("b", "a"), Link("c")], r"2 root links \(a, c\)"),
    ([Link("a", "b"), Link("b", "a")], "no root link"),
    ([Link("a"), Link("b", "c"), Link("c", "b")], "cycle of joints through the links b, c"),
    ([Link("a"), Link("b", "x", joint=Joint("j"))], "joint 'j': there is no link 'x'"),
    ([Link("a"), Link("a", "a")], "two links"),
    ([Link("a"), *(Link(n, "a", joint=Joint("j", JointType.PRISMATIC)) for n in "bc")],
     "two joints named 'j'"),
    ([Link("a"), Link("b", "a", joint=Joint("", JointType.PRISMATIC))], "without a name"),
    ([Link("a"), Link("b", "a", joint=Joint("j", JointType.REVOLUTE, (0, 0, 2)))], "unit vector"),
])
def test_links_that_make_no_model_are_refused(links: list[Link], reason: str) -> None:
    with pytest.raises(ModelError, match=reason):
        ArticulatedModel.from_links("broken", links)


def test_kept_order_needs_parents_first() -> None:
    with pytest.raises(ModelError, match="before its parent"):
        ArticulatedModel.from_links("x", [Link("b", "a"), Link("a")], keep_order=True)


def test_a_deep_chain_needs_no_deep_stack() -> None:
    names = [f"p{i}" for i in range(4000)]
    links = [Link(name, parent) for name, parent in zip(names, (None, *names), strict=False)]
    assert ArticulatedModel.from_links("chain", links[::-1]).part_names == tuple(names)


def test_a_model_without_joints_stands_still(tmp_path: Path) -> None:
    m = model_of(tmp_path, '<robot name="r"><link name="only"/></robot>')
    assert m.limits.shape == (0, 2) and m.joint_child.shape == (0,)
    np.testing.assert_array_equal(forward_kinematics(m, np.zeros((5, 0))),
                                  np.broadcast_to(np.eye(4), (5, 1, 4, 4)))
    assert joint_screws(m, forward_kinematics(m, [])).shape == (0, 6)


@st.composite
def trees(draw: st.DrawFn) -> list[Link]:
    """Links of a random tree, parents before children, with every type of joint and mimics."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    links = [Link("0")]
    for k in range(1, draw(st.integers(2, 8))):
        axis = rng.normal(size=3)
        moving = [link.joint.name for link in links if link.joint.type is not JointType.FIXED]
        mimic = None
        if moving and draw(st.booleans()):
            mimic = Mimic(draw(st.sampled_from(moving)), *rng.normal(size=2).tolist())
        joint = Joint(f"joint {k}", draw(st.sampled_from(JointType)), axis / np.linalg.norm(axis),
                      rng.normal(size=3), mimic=mimic)
        pose = transform(rotation_from_rpy(rng.normal(size=3)), rng.normal(size=3))
        parent = str(draw(st.integers(0, k - 1)))
        links.append(Link(str(k), parent, pose, joint))
    return links


def value_of(joint: Joint, joints: dict[str, Joint], q: dict[str, float]) -> float:
    if joint.mimic is None:
        return q[joint.name]
    leader = value_of(joints[joint.mimic.joint], joints, q)
    return joint.mimic.multiplier * leader + joint.mimic.offset


@given(trees(), st.randoms(use_true_random=False))
def test_a_pose_is_the_product_of_joint_motions_in_any_order_of_links(
    links: list[Link], random: Random
) -> None:
    joints = {link.joint.name: link.joint for link in links}
    q = {name: random.uniform(-2, 2) for name in joints}
    expected = {"0": np.eye(4)}
    for link in links[1:]:
        motion = np.eye(4)
        if link.joint.type is not JointType.FIXED:
            value = value_of(link.joint, joints, q)
            axis, point = np.asarray(link.joint.axis), np.asarray(link.joint.point)
            if link.joint.type is JointType.PRISMATIC:
                motion = transform(None, value * axis)
            else:
                motion = (transform(None, point) @ transform(rotation_about(axis, value))
                          @ transform(None, -point))
        assert link.parent is not None
        expected[link.name] = expected[link.parent] @ link.parent_from_link_at_zero @ motion
    for order in (links, random.sample(links, len(links))):
        model = ArticulatedModel.from_links("tree", order)
        assert (model.parent < np.arange(len(links))).all()
        poses = forward_kinematics(model, [q[name] for name in model.joint_names])
        for name, pose in zip(model.part_names, poses, strict=True):
            np.testing.assert_allclose(pose, expected[name], atol=1e-9)
