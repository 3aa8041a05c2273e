"""The verifier reads link poses from a URDF as the loader does, and ignores all else in it."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from gcbench.errors import ModelError
from gcbench.renderer.verify.kinematics import poses_from_urdf
from gcbench.renderer.verify.urdf_reader import read_urdf_tree
from gcbench.robots.model import forward_kinematics
from gcbench.robots.urdf import load_urdf
from hypothesis import given, settings
from hypothesis import strategies as st

IGNORED = (
    "<collision/>",
    "<collision><geometry><plane normal='0 0 1'/></geometry></collision>",
    "<inertial><mass value='heavy'/><inertia ixx='n/a' iyy='' izz='1e999'/></inertial>",
    "<visual/>",
    "<visual><geometry><box size='1 2 3'/></geometry></visual>",
    "<gazebo><plugin filename='x.so'/></gazebo>",
)
IGNORED_OF_JOINTS = (
    "",
    "<dynamics damping='${d}'/>",
    "<safety_controller k_velocity='n/a'/>",
    "<limit lower='-1' upper='1' effort='e' velocity='${v}'/>",
)
KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")


@st.composite
def urdfs(draw: st.DrawFn) -> str:
    """A tree of up to 8 links, written in the ways that the loader accepts."""
    number = st.floats(-3, 3).map(lambda x: round(x, 3))
    gap = draw(st.sampled_from((" ", "  ", ", ", "\n")))

    def triple() -> str:
        return gap.join(str(draw(number)) for _ in range(3))

    count = draw(st.integers(1, 8))
    text = [f"<link name=' l{i} '>{draw(st.sampled_from(IGNORED))}</link>" for i in range(count)]
    for i in range(1, count):
        parts = [f"<parent link='l{draw(st.integers(0, i - 1))}'/><child link='l{i}'/>"]
        if draw(st.booleans()):
            rpy = f" rpy='{triple()}'" if draw(st.booleans()) else " rpy=' '"
            parts.append(f"<origin xyz='{triple()}'{rpy}/>")
        if draw(st.booleans()):
            axis = draw(st.sampled_from(("0 0 2", "1 0 0", "0 -0.5 0", "1,1,1", ".3 -4. 1e-1")))
            parts.append(f"<axis xyz='{axis}'/>")
        if i > 1 and draw(st.booleans()):
            leader, scale = draw(st.integers(1, i - 1)), draw(st.sampled_from(("", "2", "-0.5")))
            multiplier = f" multiplier='{scale}'" if scale else ""
            parts.append(f"<mimic joint='j{leader}'{multiplier} offset='{draw(number)}'/>")
        parts.append(draw(st.sampled_from(IGNORED_OF_JOINTS)))
        kind = draw(st.sampled_from(KINDS))
        text.append(f"<joint name='j{i}' type='{kind}'>{''.join(parts)}</joint>")
    if draw(st.booleans()):
        text.append("<joint name='to_world' type='fixed'><parent link='world'/>"
                    "<child link='l0'/></joint>")
    order = draw(st.permutations(text))
    name = draw(st.sampled_from(("", " name='r'", " name=' '", " version='x'")))
    return f"<robot{name}>{''.join(order)}<transmission/></robot>"


@settings(deadline=None)
@given(text=urdfs(), seed=st.integers(0, 99))
def test_links_stand_where_the_loader_puts_them(text: str, seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fuzzed.urdf"
        path.write_text(text)
        model = load_urdf(path, allow_missing=True)  # goes without planes
        q = np.random.default_rng(seed).uniform(-2, 2, (2, len(model.joint_names)))
        found = poses_from_urdf(path, model.joint_names, q)
    expected = forward_kinematics(model, q)
    assert set(found) == set(model.part_names)
    for p, name in enumerate(model.part_names):
        np.testing.assert_allclose(found[name], expected[:, p], atol=1e-9)


def test_poses_come_from_the_urdf_itself(tmp_path: Path) -> None:
    """A mimic of a mimic, an axis that is not of unit length, an unknown joint."""
    urdf = tmp_path / "chain.urdf"
    urdf.write_text("""<robot name="chain">
      <link name="a"/><link name="b"/><link name="c"/><link name="d"/><link name="e"/>
      <joint name="ab" type="revolute"><parent link="a"/><child link="b"/>
        <origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/><axis xyz="0 0 2"/>
        <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
      <joint name="bc" type="continuous"><parent link="b"/><child link="c"/>
        <origin xyz="1 0 0"/><axis xyz="0 0 1"/><mimic joint="ab" multiplier="2" offset="0.1"/>
        </joint>
      <joint name="cd" type="prismatic"><parent link="c"/><child link="d"/>
        <axis xyz="1 0 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/>
        <mimic joint="bc" multiplier="-1"/></joint>
      <joint name="de" type="fixed"><parent link="d"/><child link="e"/><origin xyz="0 0 1"/></joint>
    </robot>""")
    q = np.array([[0.0], [0.5]])
    poses = poses_from_urdf(urdf, ("ab",), q)
    for t, (angle,) in enumerate(q):
        first, second = np.pi / 2 + angle, 2 * angle + 0.1
        b = np.array([1.0, 0, 0])
        c = b + np.array([np.cos(first), np.sin(first), 0])
        along = np.array([np.cos(first + second), np.sin(first + second), 0])
        np.testing.assert_allclose(poses["b"][t, :3, 3], b, atol=1e-12)
        np.testing.assert_allclose(poses["c"][t, :3, 3], c, atol=1e-12)
        np.testing.assert_allclose(poses["e"][t, :3, 3], c - second * along + [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(poses["e"][t, :3, 0], along, atol=1e-12)


def chain(links: int) -> str:
    joints = "".join(
        f"<joint name='j{i}' type='prismatic'><parent link='l{i - 1}'/><child link='l{i}'/>"
        f"<axis xyz='1 0 0'/></joint>" for i in range(1, links))
    return "<robot>" + "".join(f"<link name='l{i}'/>" for i in range(links)) + joints + "</robot>"


def test_a_long_chain_needs_no_deep_stack(tmp_path: Path) -> None:
    path = tmp_path / "chain.urdf"
    path.write_text(chain(1900))
    poses = poses_from_urdf(path, ("j1", "j1899"), np.array([[2.0, 3.0]]))
    assert poses["l1899"][0, 0, 3] == pytest.approx(5.0)


TWO = "<link name='a'/><link name='b'/>"
ENDS = "<parent link='a'/><child link='b'/>"


@pytest.mark.parametrize(("text", "reason"), [
    ("<robot", "well-formed"),
    ("<!DOCTYPE r [<!ENTITY e 'x'>]><robot/>", "DOCTYPE"),
    ("<sdf/>", "not <robot>"),
    ("<robot><link/></robot>", "has no 'name'"),
    (f"<robot>{TWO}<joint name='j' type='revolute'>{ENDS}<axis xyz='0 0 0'/></joint></robot>",
     "axis is zero"),
    (f"<robot>{TWO}<joint name='j' type='fixed'>{ENDS}<origin xyz='0 0 inf'/></joint></robot>",
     "3 finite numbers"),
    (f"<robot>{TWO}<joint name='j' type='fixed'><child link='b'/></joint></robot>",
     "has no 'link'"),
    (f"<robot>{TWO}<joint name='j' type='fixed'>{ENDS}</joint><joint name='k' type='fixed'>"
     "<parent link='b'/><child link='a'/></joint></robot>", "tree"),
    (f"<robot>{TWO}<joint name='j' type='fixed'>{ENDS}</joint><joint name='j' type='fixed'>"
     "<parent link='b'/><child link='c'/></joint></robot>", "one name"),
    (chain(2002), "more than 2000"),
])
def test_what_is_no_tree_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "wrong.urdf"
    path.write_text(text)
    with pytest.raises(ModelError, match=reason):
        read_urdf_tree(path)


def test_mimics_in_a_circle_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "wrong.urdf"
    path.write_text(f"<robot>{TWO}<joint name='j' type='revolute'>{ENDS}<mimic joint='j'/></joint>"
                    "</robot>")
    with pytest.raises(ModelError, match="mimics"):
        poses_from_urdf(path, (), np.zeros((1, 0)))
