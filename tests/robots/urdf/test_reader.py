"""The URDF reader on well-meant files: references, joints, materials."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.renderer.verify.kinematics import poses_from_urdf
from gcbench.robots.catalog import load_robot
from gcbench.robots.files.paths import MissingAssetError
from gcbench.robots.model import ArticulatedModel, JointType, forward_kinematics
from gcbench.robots.model.texture import linear_from_srgb
from gcbench.robots.urdf.reader import load_urdf
from PIL import Image

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def robot(body: str, name: str = "r") -> str:
    return f'<?xml version="1.0"?>\n<robot name="{name}">{body}</robot>'


def link(name: str, geometry: str = "", material: str = "", origin: str = "") -> str:
    if not geometry:
        return f'<link name="{name}"/>'
    return (f'<link name="{name}"><visual>{origin}<geometry>{geometry}</geometry>{material}'
            "</visual></link>")


def joint(name: str, parent: str, child: str, kind: str = "revolute", more: str = "") -> str:
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f"{more}</joint>")


def load(path: Path, text: str, **options: object) -> ArticulatedModel:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return load_urdf(path, **options)  # type: ignore[arg-type]


def mesh_robot(reference: str) -> str:
    return robot(link("base", f'<mesh filename="{reference}"/>'))


def put(path: Path, content: str = OBJ) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)


def test_a_model_says_where_it_came_from(tmp_path: Path) -> None:
    path = tmp_path / "my.urdf"
    m = load(path, robot(link("base", '<box size="1 2 3"/>'), "arm"))
    assert (m.name, m.source) == ("arm", "my.urdf")
    assert m.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert m.notes == ()


def test_loading_twice_gives_the_same(tmp_path: Path) -> None:
    put(tmp_path / "a.obj")
    text = robot(link("base", '<mesh filename="a.obj"/>') + link("tip", '<sphere radius="1"/>')
                 + joint("j", "base", "tip", "continuous"))
    a, b = (load(tmp_path / "m.urdf", text) for _ in range(2))
    for x, y in zip(a.visuals, b.visuals, strict=True):
        np.testing.assert_array_equal(x.vertices, y.vertices)
        np.testing.assert_array_equal(x.faces, y.faces)
        np.testing.assert_array_equal(x.normals, y.normals)


# References --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("reference", "place"), [
    ("a.obj", "pkg/urdf/a.obj"),
    ("meshes/a.obj", "pkg/urdf/meshes/a.obj"),
    ("../meshes/a.obj", "pkg/meshes/a.obj"),
    ("./../meshes//a.obj", "pkg/meshes/a.obj"),
    ("meshes/a.obj", "pkg/meshes/a.obj"),
    ("file://meshes/a.obj", "pkg/urdf/meshes/a.obj"),
    ("package://a.obj", "pkg/urdf/a.obj"),
    ("package://pkg/meshes/a.obj", "pkg/meshes/a.obj"),
    ("package:///pkg/meshes/a.obj", "pkg/meshes/a.obj"),
    ("package://pkg/urdf/../meshes/a.obj", "pkg/meshes/a.obj"),
    ("package://renamed/meshes/a.obj", "pkg/meshes/a.obj"),
    ("meshes\\a.obj", "pkg/urdf/meshes/a.obj"),
    ("meshes/a%20b.obj", "pkg/urdf/meshes/a b.obj"),
])
def test_references_are_found(tmp_path: Path, reference: str, place: str) -> None:
    put(tmp_path / "ws" / place)
    put(tmp_path / "ws/pkg/package.xml", "<package/>")
    m = load(tmp_path / "ws/pkg/urdf/m.urdf", mesh_robot(reference))
    assert len(m.visuals[0].faces) == 4


def test_packages_are_found_by_map_and_by_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    put(tmp_path / "far/away/v2/meshes/a.obj")
    path, text = tmp_path / "here/m.urdf", mesh_robot("package://v2/meshes/a.obj")
    with pytest.raises(MissingAssetError):
        load(path, text, asset_root=tmp_path / "here")
    options = {"asset_root": tmp_path / "here"}
    assert load(path, text, packages={"v2": tmp_path / "far/away/v2"}, **options).visuals
    for entry in ("far/away", "far/away/v2"):
        monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / entry}")
        assert load(path, text, **options).visuals


def test_a_missing_mesh_stops_the_load_with_the_places_tried(tmp_path: Path) -> None:
    text = robot(link("base", '<mesh filename="package://p/x.stl"/>')
                 + link("tip", '<box size="1 1 1"/>') + joint("j", "base", "tip", "fixed"))
    with pytest.raises(MissingAssetError) as caught:
        load(tmp_path / "p/urdf/m.urdf", text)
    message = str(caught.value)
    assert "\n" not in message and "m.urdf" in message and "--allow-missing" in message
    for place in ("p/urdf/p/x.stl", "p/urdf/x.stl", "p/x.stl"):
        assert str(tmp_path / place) in message
    m = load(tmp_path / "p/urdf/m.urdf", text, allow_missing=True)
    assert [v.part for v in m.visuals] == [1]
    assert m.notes == ("link 'base': mesh 'package://p/x.stl' is missing and left out",)


# Joints ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["floating", "planar", "spherical"])
def test_joints_of_many_degrees_are_frozen_and_noted(tmp_path: Path, kind: str) -> None:
    m = load(tmp_path / "m.urdf", robot(link("a") + link("b") + joint("j", "a", "b", kind)))
    assert m.joint_names == () and m.part_joint_types[1] is JointType.FIXED
    assert any(f"'j' is {kind}" in note for note in m.notes)


@pytest.mark.parametrize(("limit", "expected", "kind", "note"), [
    ("", (-np.inf, np.inf), "continuous", "without limits"),
    ('<limit effort="1" velocity="1"/>', (-np.inf, np.inf), "continuous", "without limits"),
    ('<limit lower="-1" upper="2"/>', (-1, 2), "revolute", ""),
    ('<limit upper="2"/>', (0, 2), "revolute", ""),
    ('<limit lower="2" upper="-1"/>', (-1, 2), "revolute", "swapped"),
    ('<limit lower="-1e16" upper="1e16"/>', (-np.inf, np.inf), "continuous", "taken as none"),
])
def test_limits(
    tmp_path: Path, limit: str, expected: tuple[float, float], kind: str, note: str
) -> None:
    text = robot(link("a", '<box size="1 1 1"/>') + link("b") + joint("j", "a", "b", more=limit))
    m = load(tmp_path / "m.urdf", text)
    np.testing.assert_array_equal(m.limits, [expected])
    assert m.joint_types == (kind,)
    assert any(note in n for n in m.notes) if note else not m.notes


def test_an_undeclared_world_is_added(tmp_path: Path) -> None:
    m = load(tmp_path / "m.urdf", robot(link("a") + joint("j", "world", "a", "fixed")))
    assert m.part_names == ("world", "a") and any("world" in n for n in m.notes)


# Visuals -----------------------------------------------------------------------------------------


def test_origins_place_visuals_in_the_part(tmp_path: Path) -> None:
    origin = '<origin xyz="10 0 0" rpy="0 0 1.5707963267948966"/>'
    m = load(tmp_path / "m.urdf", robot(link("a", '<box size="2 4 6"/>', origin=origin)))
    v = m.visuals[0].vertices
    np.testing.assert_allclose(v.min(0), [8, -1, -3])
    np.testing.assert_allclose(v.max(0), [12, 1, 3])


@pytest.mark.parametrize(("geometry", "high"), [
    ('<box size="2 4 6"/>', [1, 2, 3]),
    ('<sphere radius="2"/>', [2, 2, 2]),
    ('<cylinder radius="1" length="4"/>', [1, 1, 2]),
    ('<capsule radius="1" length="4"/>', [1, 1, 3]),
    ('<mesh filename="a.obj" scale="2 3 4"/>', [2, 3, 4]),
    ('<mesh filename="a.obj" scale="2"/>', [2, 2, 2]),
    ('<mesh filename="a.obj" scale="-1 1 1"/>', [0, 1, 1]),
])
def test_geometries(tmp_path: Path, geometry: str, high: list[float]) -> None:
    put(tmp_path / "a.obj")
    m = load(tmp_path / "m.urdf", robot(link("a", geometry)))
    (v,) = m.visuals
    np.testing.assert_allclose(v.vertices.max(0), high, atol=1e-12)
    p = v.vertices[v.faces]
    assert np.einsum("fi,fi->", p[:, 0], np.cross(p[:, 1], p[:, 2])) > 0  # faces outward
    np.testing.assert_allclose(np.linalg.norm(v.normals, axis=1), 1)
    assert v.vertices.dtype == np.float64 and v.faces.dtype == np.int32


def test_materials_by_name_and_colours_in_linear_light(tmp_path: Path) -> None:
    text = robot(
        '<material name="paint"><color rgba="0.5 0.25 1 0.5"/></material>'
        + link("a", '<box size="1 1 1"/>', '<material name="paint"/>')
        + link("b", '<box size="1 1 1"/>',
               '<material name="gray"><color rgba="1 0 0 1"/></material>')
        + link("c", '<box size="1 1 1"/>', '<material name="gray"/>')
        + link("d", '<box size="1 1 1"/>', '<material name="nobody"/>')
        + joint("ab", "a", "b", "fixed") + joint("bc", "b", "c", "fixed")
        + joint("cd", "c", "d", "fixed"))
    m = load(tmp_path / "m.urdf", text)
    colors = [v.material.base_color for v in m.visuals]
    np.testing.assert_allclose(colors[0], [*linear_from_srgb([0.5, 0.25, 1]), 0.5])
    assert colors[1] == colors[2] == (1, 0, 0, 1)
    assert any("nobody" in note for note in m.notes)


def test_a_material_of_the_urdf_yields_to_that_of_the_mesh(tmp_path: Path) -> None:
    put(tmp_path / "bare.obj")
    put(tmp_path / "own.obj", "mtllib own.mtl\nusemtl green\n" + OBJ)
    put(tmp_path / "own.mtl", "newmtl green\nKd 0 1 0\n")
    red = '<material name="red"><color rgba="1 0 0 1"/></material>'
    text = robot(link("a", '<mesh filename="bare.obj"/>', red)
                 + link("b", '<mesh filename="own.obj"/>', red) + joint("j", "a", "b", "fixed"))
    bare, own = load(tmp_path / "m.urdf", text).visuals
    assert bare.material.base_color == (1, 0, 0, 1)
    assert own.material.base_color == (0, 1, 0, 1)


def test_textures_of_the_urdf(tmp_path: Path) -> None:
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "t.png")
    put(tmp_path / "no_uv.obj")
    look = '<material name="t"><texture filename="t.png"/></material>'
    text = robot(link("a", '<box size="1 1 1"/>', look)
                 + link("b", '<mesh filename="no_uv.obj"/>', look) + joint("j", "a", "b", "fixed"))
    on_box, on_mesh = load(tmp_path / "m.urdf", text).visuals
    assert on_box.material.texture is not None and on_box.uv is not None
    assert on_mesh.material.texture is None  # nowhere to put it: the mean colour stays
    np.testing.assert_allclose(on_mesh.material.base_color, [1, 0, 0, 1])


def test_what_an_alpha_of_zero_hides_has_no_depth_either(tmp_path: Path) -> None:
    look = '<material name="{0}"><color rgba="1 0 0 {0}"/></material>'
    text = robot("".join(link(f"l{a}", '<box size="1 1 1"/>', look.format(a)) for a in (0, 0.5, 1))
                 + joint("a", "l0", "l0.5", "fixed") + joint("b", "l0.5", "l1", "fixed"))
    materials = [v.material for v in load(tmp_path / "m.urdf", text).visuals]
    assert [m.alpha_cutoff for m in materials] == [0.02, None, None]
    assert [m.transparent for m in materials] == [True, True, False]


def test_visuals_of_one_material_are_joined_per_part(tmp_path: Path) -> None:
    one = ('<visual><geometry><box size="1 1 1"/></geometry><material name="x">'
           '<color rgba="{} 0 0 1"/></material></visual>')
    m = load(tmp_path / "m.urdf", robot('<link name="a">' + one.format(1) + one.format(0.5)
                                        + one.format(1) + "</link>"))
    assert sorted(len(v.faces) for v in m.visuals) == [12, 24]


def test_odd_but_common_files_load(tmp_path: Path) -> None:
    text = ('\n <?xml version="1.0"?><!-- <xacro:macro> ${x} --><robot xmlns:xacro="http://x">'
            '<xacro:property name="k" value="1"/><gazebo><sensor:camera a="${b}"/></gazebo>'
            '<link name="a"><inertial><mass value="nan"/></inertial><visual>'
            '<origin xyz="0, 0, 1"/><geometry><box size="1 1 1"/></geometry></visual>'
            "<visual/></link></robot>")
    m = load(tmp_path / "m.urdf", text)
    assert m.name == "m" and m.visuals[0].vertices[:, 2].max() == 1.5
    assert len(m.notes) == 2  # no name, and a visual without geometry


def test_world_poses_carry_the_visuals(tmp_path: Path) -> None:
    text = robot(link("a") + link("b", '<box size="1 1 1"/>')
                 + joint("j", "a", "b", "prismatic", '<origin xyz="0 5 0"/><axis xyz="0 0 1"/>'
                         '<limit lower="0" upper="2"/>'))
    m = load(tmp_path / "m.urdf", text)
    np.testing.assert_allclose(forward_kinematics(m, [2.0])[1, :3, 3], [0, 5, 2])


def test_errors_are_the_users_kind(tmp_path: Path) -> None:
    with pytest.raises(GcbenchError, match="no such file"):
        load_urdf(tmp_path / "nothing.urdf")


def test_collision_geometry_stands_in_only_where_nothing_is_visible(tmp_path: Path) -> None:
    body = '<link name="a"><collision><geometry><box size="1 1 1"/></geometry></collision></link>'
    model = load(tmp_path / "a.urdf", robot(body))
    assert len(model.visuals) == 1
    assert any("collision geometry is shown" in note for note in model.notes)
    seen = link("b", '<box size="2 2 2"/>') + joint("j", "b", "a")
    model = load(tmp_path / "b.urdf", robot(body + seen))
    assert [model.part_names[v.part] for v in model.visuals] == ["b"]


@pytest.mark.parametrize(("geometry", "size"), [
    ('<box size="2 0 1"/>', (2.0, 1e-4, 1.0)), ('<cylinder radius="1" length="0"/>', (2, 2, 1e-4)),
    ('<sphere radius="0"/>', None), ('<box size="0 0 0"/>', None), ('<box size="1 0 0"/>', None),
    ('<cylinder radius="0" length="1"/>', None), ('<capsule radius="0" length="1"/>', None),
])
def test_shapes_without_thickness_are_thin_and_those_without_size_are_left_out(
    tmp_path: Path, geometry: str, size: tuple[float, ...] | None
) -> None:
    m = load(tmp_path / "m.urdf", robot(link("a", geometry) + link("b", '<box size="1 1 1"/>')
                                        + joint("j", "a", "b", "fixed")))
    assert len(m.visuals) == (1 if size is None else 2)
    assert any("'a': a " in n and "without size is left out" in n for n in m.notes) == (
        size is None)
    if size is not None:
        np.testing.assert_allclose(np.ptp(m.visuals[0].vertices, axis=0), size)


def test_stray_xacro_elements_are_ignored_with_a_note(tmp_path: Path) -> None:
    stray = '<xacro:include filename="x"/><xacro:arg name="a" default="1"/>'
    m = load(tmp_path / "m.urdf", robot(stray + link("a", '<box size="1 1 1"/>')))
    assert m.notes == ("xacro elements are ignored: xacro:include",)


def test_a_scale_multiplies_all_lengths(tmp_path: Path) -> None:
    limit = '<limit lower="-1" upper="2"/>'
    text = robot(
        link("a", '<box size="1 1 1"/>') + link("b", '<box size="1 2 3"/>') + link("c")
        + link("d", '<sphere radius="1"/>')
        + joint("turn", "a", "b", more=f'<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/>{limit}')
        + joint("slide", "b", "c", "prismatic", f'<origin xyz="0 1 0"/>{limit}')
        + joint("follow", "c", "d", "prismatic",
                '<mimic joint="turn" multiplier="0.5" offset="0.25"/>'))
    plain = load(tmp_path / "m.urdf", text)
    small = load_robot(tmp_path / "m.urdf", scale=0.01)
    np.testing.assert_allclose(small.limits, [[-1, 2], [-0.01, 0.02]])
    one = forward_kinematics(plain, [0.7, 0.3])
    other = forward_kinematics(small, [0.7, 0.003])
    np.testing.assert_allclose(other[:, :3, :3], one[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(other[:, :3, 3], 0.01 * one[:, :3, 3], atol=1e-12)
    for a, b in zip(plain.visuals, small.visuals, strict=True):
        np.testing.assert_allclose(b.vertices, 0.01 * a.vertices)
    found = poses_from_urdf(tmp_path / "m.urdf", small.joint_names, np.array([[0.7, 0.003]]),
                            scale=0.01)
    for name, pose in zip(small.part_names, other, strict=True):
        np.testing.assert_allclose(found[name][0], pose, atol=1e-12)
    with pytest.raises(GcbenchError, match="ur5 is in metres; --scale is for files"):
        load_robot("ur5", scale=2.0)


def test_the_largest_limit_is_in_metres_whatever_the_unit(tmp_path: Path) -> None:
    text = robot(link("a", '<box size="500 500 500"/>') + link("b") + link("c") + link("d")
                 + joint("slide", "a", "b", "prismatic", '<limit lower="0" upper="1500"/>')
                 + joint("free", "a", "c", "prismatic", '<limit lower="-1e9" upper="1e9"/>')
                 + joint("turn", "a", "d", more='<limit lower="-1500" upper="1500"/>'))
    small = load(tmp_path / "m.urdf", text, scale=0.001)
    np.testing.assert_allclose(small.limits, [[0, 1.5], [-np.inf, np.inf], [-np.inf, np.inf]])
    plain = load(tmp_path / "m.urdf", text)
    np.testing.assert_allclose(plain.limits, [[0, np.inf], *[[-np.inf, np.inf]] * 2])


def test_a_joint_that_mimics_nothing_moves_by_itself(tmp_path: Path) -> None:
    path = tmp_path / "m.urdf"
    path.write_text("""<robot name="m"><link name="a"/><link name="b"><visual><geometry>
<sphere radius="1"/></geometry></visual></link><joint name="j" type="continuous"><parent link="a"/>
<child link="b"/><axis xyz="0 0 1"/><mimic joint="gone" multiplier="2"/></joint></robot>""")
    model = load_urdf(path)
    assert model.notes == ("joint 'j': mimics 'gone', which does not exist: moves by itself",)
    turned = forward_kinematics(model, np.array([0.5]))[1]
    assert np.allclose(poses_from_urdf(path, ("j",), np.array([[0.5]]))["b"][0], turned)
