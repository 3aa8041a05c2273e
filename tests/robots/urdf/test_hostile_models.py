"""Files that are broken or mean harm: each is refused in one line that names it."""

from __future__ import annotations

import io
import json
import os
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from gcbench.errors import ModelError
from gcbench.robots.catalog import load_robot
from gcbench.robots.files import paths as references
from gcbench.robots.files import read_bounded
from gcbench.robots.meshes import MeshLimits
from gcbench.robots.model import ArticulatedModel
from gcbench.robots.urdf.library import MeshLibrary
from gcbench.robots.urdf.reader import load_urdf

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
OBJ_UV = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
BOMB = ('<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">]>')
COLLADA = ('<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset/>'
           "{}</COLLADA>")


ASSET = {"asset": {"version": "2.0"}}


def gltf_with_buffer(uri: str) -> bytes:
    """A mesh whose numbers are in another file."""
    return json.dumps({
        **ASSET, "nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {
            "POSITION": 0}}]}], "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3,
                                              "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": uri}]}).encode()


def refuse(path: Path, reason: str, content: str | bytes | None = None, **options: object) -> str:
    """Load must fail in one line that names the file and the reason."""
    if content is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ModelError, match=reason) as caught:
        load_urdf(path, **options)  # type: ignore[arg-type]
    text = str(caught.value)
    assert path.name in text and "\n" not in text and len(text) < 3000
    return text


def with_mesh(reference: str, scale: str = "1 1 1") -> str:
    return (f'<robot name="r"><link name="a"><visual><geometry><mesh filename="{reference}" '
            f'scale="{scale}"/></geometry></visual></link></robot>')


def with_joint(inner: str, attributes: str = 'name="j" type="revolute"') -> str:
    return (f'<robot name="r"><link name="a"/><link name="b"/><joint {attributes}>{inner}</joint>'
            "</robot>")


ENDS = '<parent link="a"/><child link="b"/>'


@pytest.mark.parametrize(("text", "reason"), [
    ("", "not well-formed"),
    ("<robot", "not well-formed"),
    ('<sdf version="1"/>', "not a URDF"),
    ('<robot name="r"/>', "no links"),
    (f'{BOMB}<robot name="&c;"/>', "DOCTYPE"),
    ('<!DOCTYPE robot SYSTEM "file:///etc/passwd"><robot name="r"/>', "DOCTYPE"),
    ('<robot name="r"><link/></robot>', "has no 'name'"),
    ('<robot name="r"><link name=" "/></robot>', "has no 'name'"),
    ('<robot name="r"><link name="a"/><link name="a"/></robot>', "two links named 'a'"),
    ('<robot name="r"><link name="' + "x" * 300 + '"/></robot>', "longer than 256"),
    ('<robot name="r"><link name="' + "x" * 5000 + '"/></robot>', "longer than 4096"),
    ('<robot name="r"><link name="${p}_a"/></robot>', "xacro"),
    ('<robot name="r"><xacro:include filename="x"/></robot>', "only un-expanded xacro"),
    ('<robot name="r"><link name="a"/><link name="b"/></robot>', "2 root links"),
    (with_joint(ENDS, 'type="fixed"'), "has no 'name'"),
    (with_joint(ENDS, 'name="j"'), "type '' is unknown"),
    (with_joint(ENDS, 'name="j" type="screw"'), "type 'screw' is unknown"),
    (with_joint('<child link="b"/>'), "no <parent>"),
    (with_joint('<parent/><child link="b"/>'), "has no 'link'"),
    (with_joint('<parent link="a"/><child link="z"/>'), "no link 'z'"),
    (with_joint(ENDS + '<axis xyz="0 0 0"/>'), "axis is zero"),
    (with_joint(ENDS + '<axis xyz="0 0"/>'), "should be 3 numbers"),
    (with_joint(ENDS + '<axis xyz="0 0 nan"/>'), "not a finite number"),
    (with_joint(ENDS + '<origin xyz="0 0 inf"/>'), "not a finite number"),
    (with_joint(ENDS + '<origin xyz="0 0 1e999"/>'), "not a finite number"),
    (with_joint(ENDS + '<origin xyz="0 0 1e12"/>'), "larger than"),
    (with_joint(ENDS + '<origin rpy="-1.57. 0 0"/>'), "not a finite number: '-1.57.'"),
    (with_joint(ENDS + '<origin rpy="1_0 0 0"/>'), "not a finite number"),
    (with_joint(ENDS + '<origin xyz="${a} 0 0"/>'), "xacro"),
    (with_joint(ENDS + '<limit lower="nan" upper="1"/>'), "not a finite number"),
    (with_joint(ENDS + '<mimic joint="j"/>'), "cycle"),
    (with_joint(ENDS + "<mimic/>"), "has no 'joint'"),
])
def test_broken_documents(tmp_path: Path, text: str, reason: str) -> None:
    refuse(tmp_path / "m.urdf", reason, text)


@pytest.mark.parametrize(("geometry", "reason"), [
    ('<sphere radius="-1"/>', "must be positive"),
    ("<sphere/>", "has no 'radius'"),
    ('<sphere radius="nan"/>', "not a finite number"),
    ('<box size="1 -1 1"/>', "must be positive"),
    ('<box size="1 1"/>', "should be 3 numbers"),
    ('<cylinder radius="1" length="-1"/>', "must be positive"),
    ('<cylinder radius="1"/>', "has no 'length'"),
    ('<box size="5000 1 1"/>', "m large"),
    ('<box size="1e-6 1e-6 1e-6"/>', "m large"),
    ('<plane normal="0 0 1"/>', "<plane> is not supported"),
    ("<mesh/>", "has no 'filename'"),
    ('<mesh filename="a.obj" scale="0 0 0"/>', "scale of zero"),
    ('<mesh filename="a.obj" scale="1 1"/>', "should be 1 or 3"),
])
def test_broken_geometry(tmp_path: Path, geometry: str, reason: str) -> None:
    (tmp_path / "a.obj").write_text(OBJ)
    refuse(tmp_path / "m.urdf", reason, f'<robot name="r"><link name="a"><visual><geometry>'
           f"{geometry}</geometry></visual></link></robot>")


def test_entities_are_seen_through_other_encodings(tmp_path: Path) -> None:
    text = f'<?xml version="1.0" encoding="UTF-16"?>{BOMB}<robot name="&c;"/>'
    refuse(tmp_path / "m.urdf", "DOCTYPE", text.encode("utf-16"))


def test_depth_and_number_of_links_are_bounded(tmp_path: Path) -> None:
    refuse(tmp_path / "deep.urdf", "levels", '<robot name="r">' + "<a>" * 100_000)
    links = "".join(f'<link name="l{i}"/>' for i in range(2001))
    refuse(tmp_path / "wide.urdf", "2000", f'<robot name="r">{links}</robot>')


@pytest.mark.parametrize(("reference", "reason"), [
    ("http://example.org/a.obj", "network"),
    ("https://example.org/a.obj", "network"),
    ("ftp://example.org/a.obj", "network"),
    ("//example.org/a.obj", "absolute"),
    ("/etc/a.obj", "absolute"),
    ("file:///etc/a.obj", "absolute"),
    ("file:/etc/a.obj", "absolute"),
    ("C:\\meshes\\a.obj", "absolute"),
    ("~/a.obj", "absolute"),
    ("/etc/passwd", "absolute"),
    ("passwd", "extension ''"),
    ("../../../../../../../../../../etc/passwd", "extension ''"),
    ("secret.txt", "extension '.txt'"),
    ("a.obj%00.txt", "extension '.txt'"),
    ("../" * 12 + "a.obj", "leads out of"),
    ("package://p/" + "../" * 12 + "a.obj", "leads out of"),
    ("%2e%2e/" * 12 + "a.obj", "leads out of"),
    ("x" * 1100 + ".obj", "longer than"),
    ("nowhere.obj", "is missing"),
])
@pytest.mark.parametrize("allow_missing", [False, True])
def test_references_that_reach_out(
    tmp_path: Path, reference: str, reason: str, allow_missing: bool
) -> None:
    path = tmp_path / "w/x/y/z/m.urdf"
    if reason == "is missing" and allow_missing:
        path.parent.mkdir(parents=True)
        path.write_text(with_mesh(reference))
        assert load_urdf(path, allow_missing=True).notes
        return
    refuse(path, reason, with_mesh(reference), allow_missing=allow_missing)


def test_a_folder_outside_the_root_is_not_reached(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(OBJ)
    refuse(tmp_path / "in/m.urdf", "leads out of", with_mesh("../a.obj"),
           asset_root=tmp_path / "in")
    assert load_urdf(tmp_path / "in/m.urdf", asset_root=tmp_path).visuals
    refuse(tmp_path / "in/m.urdf", "not inside", asset_root=tmp_path / "other")


def test_links_that_leave_the_root_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text(OBJ)
    (tmp_path / "out.obj").write_text(OBJ)
    inside = tmp_path / "in"
    inside.mkdir()
    (inside / "a.obj").symlink_to(tmp_path / "out.obj")
    (inside / "b.obj").symlink_to(inside / "plain.txt")
    (inside / "plain.txt").write_text(OBJ)
    (inside / "loop.obj").symlink_to(inside / "loop.obj")
    refuse(inside / "m.urdf", "leads out of", with_mesh("a.obj"), asset_root=inside)
    refuse(inside / "m.urdf", "missing", with_mesh("b.obj"), asset_root=inside)
    refuse(inside / "m.urdf", "missing", with_mesh("loop.obj"), asset_root=inside)


def test_pipes_are_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.obj")
    refuse(tmp_path / "m.urdf", "missing", with_mesh("a.obj"))


@pytest.mark.parametrize("reference", ["{outside}/x.png", "../x.png", "C:\\x\\x.png",
                                       "http://example.org/x.png", "x.txt", "lost.x.png"])
def test_textures_of_materials_cannot_reach_out(tmp_path: Path, reference: str) -> None:
    """A picture lies outside, a text inside; a picture inside is shown."""
    inside = tmp_path / "in"
    inside.mkdir()
    (inside / "x.txt").write_text("secret")
    for path in (tmp_path / "x.png", inside / "inside.png"):
        cv2.imwrite(str(path), np.full((4, 4, 3), 200, np.uint8))

    def loaded(image: str) -> ArticulatedModel:
        (inside / "m.mtl").write_text(f"newmtl a\nKd 1 0 0\nmap_Kd {image}\n")
        (inside / "a.obj").write_text("mtllib m.mtl\nusemtl a\n" + OBJ_UV)
        (inside / "m.urdf").write_text(with_mesh("a.obj"))
        return load_urdf(inside / "m.urdf", asset_root=inside)

    assert loaded("inside.png").visuals[0].material.texture is not None
    m = loaded(reference.format(outside=tmp_path))
    assert m.visuals[0].material.texture is None
    assert any("x.png" in n or "x.txt" in n for n in m.notes)
    assert str(tmp_path) not in " ".join(m.notes)  # notes are stored in datasets


@pytest.mark.parametrize(("name", "content", "reason"), [
    ("a.obj", b"", "empty"),
    ("a.obj", b"hello world\n", "a.obj"),
    ("a.obj", OBJ.replace("1 2 3", "1 2 9").encode(), "as OBJ .it is damaged or incomplete"),
    ("a.obj", OBJ.replace("v 1", "v nan").encode(), "finite"),
    ("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no triangles"),
    ("a.obj", b"\x89PNG\r\n\x1a\n" + bytes(100), "a.obj"),
    ("a.stl", b"\x89PNG\r\n\x1a\n" + bytes(200), "a.stl"),
    ("a.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50), "a.stl"),
    ("a.stl", b"solid x\nendsolid x\n", "a.stl"),
    ("a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\n"
              b"property float x\nend_header\n", "a.ply"),
    ("a.dae", b"solid x", "not well-formed"),
    ("a.dae", f"{BOMB}{COLLADA.format('&c;')}".encode(), "DOCTYPE"),
    ("a.dae", f'<?xml version="1.0" encoding="UTF-16"?>{BOMB}<COLLADA/>'.encode("utf-16"),
     "DOCTYPE"),
    ("a.dae", b"<html/>", "a.dae"),
    ("a.dae", COLLADA.format("").encode(), "no scene"),
    ("a.glb", b"glTF", "not a whole GLB"),
    ("a.glb", b"glTF" + b"\xff" * 40, "a.glb"),
    ("a.gltf", b"[]", "not a glTF"),
    ("a.gltf", b"{}", "a.gltf"),
    ("a.gltf", b"[" * 100_000, "a.gltf"),
    ("a.gltf", json.dumps({"asset": {"version": "1.0"}}).encode(), "glTF 2.0"),
    ("a.gltf", json.dumps({**ASSET, "accessors": [{"count": 10**20}]}).encode(),
     "count: expected int"),
    ("a.gltf", gltf_with_buffer("../" * 12 + "b.bin"), "leads out of"),
    ("a.gltf", gltf_with_buffer("http://x/b.bin"), "network"),
    ("a.gltf", gltf_with_buffer("/etc/passwd"), "absolute"),
    ("a.stl", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
])
def test_broken_meshes(tmp_path: Path, name: str, content: bytes, reason: str) -> None:
    (tmp_path / name).write_bytes(content)
    text = refuse(tmp_path / "m.urdf", reason, with_mesh(name))
    assert name in text


def test_a_zip_behind_a_collada_file_is_not_opened(tmp_path: Path) -> None:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as z:
        z.writestr("x.dae", BOMB + "<COLLADA/>")
    (tmp_path / "a.dae").write_bytes(b"<COLLADA/>" + archive.getvalue())
    refuse(tmp_path / "m.urdf", "a.dae", with_mesh("a.dae"))


def test_nodes_that_double_themselves_are_stopped(tmp_path: Path) -> None:
    nodes = "".join(f'<node id="n{i}"><instance_node url="#n{i + 1}"/>'
                    f'<instance_node url="#n{i + 1}"/></node>' for i in range(40))
    body = (f'<library_nodes>{nodes}<node id="n40"/></library_nodes><library_visual_scenes>'
            '<visual_scene id="s"><node><instance_node url="#n0"/></node></visual_scene>'
            '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>')
    (tmp_path / "a.dae").write_text(COLLADA.format(body))
    refuse(tmp_path / "m.urdf", "nodes", with_mesh("a.dae"))


def test_sizes_are_bounded(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(OBJ * 3)
    path = tmp_path / "m.urdf"
    path.write_text(with_mesh("a.obj"))
    finder = references.asset_finder(path)
    for limits, reason in ((MeshLimits(triangles=2), "more than 2 triangles"),
                           (MeshLimits(total_bytes=10), "exceed 10 bytes")):
        with pytest.raises(ModelError, match=reason):
            MeshLibrary(finder, limits).surfaces("a.obj")
    with pytest.raises(ModelError, match="larger than 10 bytes"):
        read_bounded(path, 10)


def test_the_root_is_never_the_home_or_the_file_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "u"))
    (tmp_path / "u/d/e").mkdir(parents=True)
    (tmp_path / "u/a.obj").write_text(OBJ)
    (tmp_path / "u/m.urdf").write_text(with_mesh("a.obj"))
    assert load_urdf(tmp_path / "u/m.urdf").visuals
    for package in ("u/d/e/package.xml", "u/package.xml"):
        for place in ("u/d/m.urdf", "u/d/e/m.urdf"):
            path = tmp_path / place
            assert references.asset_finder(path).root == path.parent, package
            refuse(path, "missing", with_mesh("package://u/a.obj"))
        (tmp_path / package).touch()
    assert references.asset_finder(Path("/m.urdf")).root == Path("/")  # its own folder, no other


def test_meshes_come_from_the_package_or_a_named_folder(tmp_path: Path) -> None:
    (tmp_path / "ws/arm/meshes").mkdir(parents=True)
    (tmp_path / "ws/arm/meshes/a.obj").write_text(OBJ)
    path = tmp_path / "ws/arm/model/m.urdf"
    text = refuse(path, "leads out of", with_mesh("../meshes/a.obj"))
    assert f"{tmp_path}/ws/arm/model, the folder that the model may read" in text
    assert text.endswith(f"if you trust the model, add --root {tmp_path}/ws/arm")
    assert load_urdf(path, asset_root=tmp_path / "ws/arm").visuals
    assert load_robot(path, root=tmp_path / "ws/arm").visuals
    (tmp_path / "ws/arm/package.xml").touch()
    assert load_urdf(path).visuals
    other = tmp_path / "ws/hand/urdf/m.urdf"
    refuse(other, "leads out of", with_mesh("../../arm/meshes/a.obj"))
    text = refuse(other, "is missing", with_mesh("package://arm/meshes/a.obj"))
    assert f"add --root {tmp_path}/ws, or name its package by --package NAME=DIR, or " in text
    assert load_urdf(other, {"arm": tmp_path / "ws/arm"}).visuals
    assert load_urdf(other, asset_root=tmp_path / "ws").visuals


@pytest.mark.parametrize("place", ["urdf", "robots", "urdf/left"])
def test_a_package_is_known_by_its_layout(tmp_path: Path, place: str) -> None:
    """The folders `urdf` and `meshes` side by side, also under another name than the package's."""
    for folder in ("ws/arm/meshes", "ws/arm/other", "ws/hand"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "a.obj").write_text(OBJ)
    path = tmp_path / "ws/arm" / place / "m.urdf"
    path.parent.mkdir(parents=True)
    up = "../" * len(Path(place).parts)
    for mesh in (f"{up}meshes/a.obj", "package://arm_v2/meshes/a.obj", f"{up}other/a.obj"):
        path.write_text(with_mesh(mesh))
        assert load_urdf(path).visuals
    refuse(path, "leads out of", with_mesh(f"{up}../hand/a.obj"))
    (tmp_path / "ws/arm/meshes").rename(tmp_path / "ws/arm/shapes")
    refuse(path, "leads out of", with_mesh(f"{up}shapes/a.obj"))


def test_the_root_that_an_error_names_is_enough(tmp_path: Path) -> None:
    """One mesh lies one folder above, one two above, and one nowhere."""
    (tmp_path / "my ws/arm/urdf").mkdir(parents=True)
    (tmp_path / "my ws/arm/a.obj").write_text(OBJ)
    (tmp_path / "my ws/b.obj").write_text(OBJ)
    path = tmp_path / "my ws/arm/urdf/m.urdf"
    visual = "<visual><geometry><mesh filename='../../b.obj'/></geometry></visual></link>"
    both = with_mesh("../a.obj").replace("</link>", visual)
    text = refuse(path, "leads out of", both)
    assert text.endswith(f"add --root '{tmp_path}/my ws'")
    assert load_urdf(path, asset_root=tmp_path / "my ws").visuals
    text = refuse(path, "leads out of", both.replace("../../b", "../../c"))
    assert text.endswith("add --root DIR, a folder that holds both")
    assert "--root" not in refuse(path, "is missing", with_mesh("c.obj"))


def test_a_path_may_begin_with_the_folder_of_the_file(tmp_path: Path) -> None:
    """As in models of pybullet, whose paths begin at a folder of many models."""
    (tmp_path / "ring").mkdir()
    for place in ("ring/a.obj", "ringer.obj"):
        (tmp_path / place).write_text(OBJ)
    (tmp_path / "ring/m.urdf").write_text(with_mesh("ring/a.obj"))
    assert load_urdf(tmp_path / "ring/m.urdf").visuals
    refuse(tmp_path / "ring/n.urdf", "leads out", with_mesh("ring/../ringer.obj"))


def test_a_texture_outside_is_left_out(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "x.png"), np.full((4, 4, 3), 200, np.uint8))
    (tmp_path / "in").mkdir()
    (tmp_path / "in/m.urdf").write_text(
        '<robot name="r"><link name="a"><visual><geometry><box size="1 1 1"/></geometry>'
        '<material name="m"><color rgba="1 0 0 1"/><texture filename="../x.png"/></material>'
        "</visual></link></robot>")
    model = load_urdf(tmp_path / "in/m.urdf")
    assert model.notes == ("material 'm': texture '../x.png' may not be read",)
    assert model.visuals[0].material.base_color == (1, 0, 0, 1)


def test_numbers_too_many_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "m.urdf").write_text(with_mesh("a.obj", "2 2 2 1"))
    model = load_urdf(tmp_path / "m.urdf")
    assert model.notes == ("link 'a': scale='2 2 2 1' of <mesh>: the first 3 numbers are taken",)
    refuse(tmp_path / "n.urdf", "1 or 3", with_mesh("a.obj", "2 2"))


def test_a_folder_above_has_the_name_of_its_package(tmp_path: Path) -> None:
    (tmp_path / "arm/meshes").mkdir(parents=True)
    (tmp_path / "arm/meshes/a.obj").write_text(OBJ)
    near, far = tmp_path / "arm/1/2/3/m.urdf", tmp_path / "arm/1/2/3/4/m.urdf"
    refuse(far, "is missing", with_mesh("package://arm/meshes/a.obj"))
    near.write_text(with_mesh("package://arm/meshes/a.obj"))
    assert load_urdf(near).visuals
    refuse(near, "leads out of", with_mesh("package://arm/../a.obj"))
