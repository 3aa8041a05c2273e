"""Folders in the layout of PartNet-Mobility: those of the generator, and awkward ones."""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.errors import ModelError
from gcbench.robots.appliances.generator import write_appliance
from gcbench.robots.catalog import load_robot, robot_urdf
from gcbench.robots.model import ArticulatedModel, forward_kinematics
from gcbench.robots.urdf import partnet
from gcbench.robots.urdf.partnet import part_names, scored_joints
from PIL import Image

BOX = """mtllib {name}.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
vt 0 0
vt 1 0
vt 1 1
g front
usemtl one
f 5/1 6/2 7/3
f 5/1 7/3 8/1
g back
usemtl two
f 1/1 3/3 2/2
f 1/1 4/1 3/3
g sides
f 1/1 2/2 6/3
f 1/1 6/3 5/1
f 4/1 7/2 3/3
f 4/1 8/2 7/3
"""
MTL = """newmtl one
Kd 1 1 1
map_Kd ../images/texture_0.jpg
newmtl two
Kd 0.2 0.4 0.6
d 0.5
"""
LINK = """<link name="{link}">
  <visual name="leg-3"><origin xyz="{at}"/><geometry><mesh filename="{a}"/></geometry></visual>
  <visual name="leg-3"><origin xyz="{at}"/><geometry><mesh filename="{b}"/></geometry></visual>
  <collision><origin xyz="{at}"/><geometry><mesh filename="{a}"/></geometry></collision></link>"""
TAIL = """<joint name="joint_9" type="fixed"><origin rpy="1.570796326794897 0 -1.570796326794897"
  xyz="0 0 0"/><child link="link_1"/><parent link="base"/></joint></robot>"""
JOINT = """<joint name="{name}" type="{kind}"><origin xyz="{at}"/><axis xyz="{axis}"/>
  <child link="{child}"/><parent link="{parent}"/>{limit}</joint>"""


@pytest.fixture
def awkward(tmp_path: Path) -> Path:
    """An object with a door, a continuous wheel, and a button that slides and turns."""
    folder = tmp_path / "set" / "7310"
    (folder / "textured_objs").mkdir(parents=True)
    (folder / "images").mkdir()
    Image.new("RGB", (8, 4), (200, 30, 60)).save(folder / "images" / "texture_0.jpg")
    for name in ("original-1", "new-1"):
        (folder / "textured_objs" / f"{name}.obj").write_text(BOX.format(name=name))
        (folder / "textured_objs" / f"{name}.mtl").write_text(MTL)
    a, b = "textured_objs/original-1.obj", "textured_objs/new-1.obj"
    limit = '<limit lower="{}" upper="{}"/>'
    body = "\n".join([
        '<?xml version="1.0" ?>\n<robot name="partnet_00112233445566778899aabbccddeeff">',
        '<link name="base"/>',
        *(LINK.format(link=f"link_{k}", at=at, a=a, b=b)
          for k, at in enumerate(("0.5 0 0", "0 0 0", "0 -1 0", "0 0 -1"))),
        '<link name="link_2_helper"/>',
        JOINT.format(name="joint_0", kind="revolute", at="-0.5 0 0", axis="0 -1 0",
                     child="link_0", parent="link_1", limit=limit.format(0, 1.57)),
        JOINT.format(name="joint_2_helper", kind="prismatic", at="0 1 0", axis="0 0 1",
                     child="link_2_helper", parent="link_1", limit=limit.format(0, 0.2)),
        JOINT.format(name="joint_2", kind="continuous", at="0 0 0", axis="0 0 1",
                     child="link_2", parent="link_2_helper", limit=""),
        JOINT.format(name="joint_3", kind="revolute", at="0 0 1", axis="1 0 0",
                     child="link_3", parent="link_1", limit=limit.format(-0.5, 0.5)),
        TAIL])
    (folder / "mobility.urdf").write_text(body)
    (folder / "semantics.txt").write_text(
        "link_0 hinge rotation_door\nlink_1 heavy door_frame\nlink_2 slider+ button\n"
        "link_3 hinge rotation_door\n")
    return folder


def load(folder: Path, **options: bool) -> ArticulatedModel:
    return load_robot("partnet:7310", {"partnet": folder.parent}, **options)


def test_an_object_of_the_users_folder_loads(awkward: Path) -> None:
    model = load(awkward)
    assert (model.name, model.licence) == ("partnet:7310", partnet.LICENCE)
    assert model.part_names[:2] == ("base", "door_frame")
    assert {*model.part_names[2:]} == {"rotation_door", "rotation_door_2", "button",
                                       "button_helper"}
    kinds = dict(zip(model.joint_names, model.joint_types, strict=True))
    assert kinds == {"rotation_door": "revolute", "rotation_door_2": "revolute",
                     "button_helper": "prismatic", "button": "continuous"}
    assert scored_joints(model) == ("rotation_door", "rotation_door_2")
    assert any("link_0 is rotation_door" in note for note in model.notes)
    # both visuals of the same name, all groups of both materials, the texture of ../images
    door = [v for v in model.visuals if model.part_names[v.part] == "rotation_door"]
    assert sum(len(v.faces) for v in door) == 16
    textured = [v for v in door if v.material.texture is not None]
    assert textured and textured[0].material.texture is not None
    assert abs(int(textured[0].material.texture[0, 0, 0]) - 200) < 6
    assert {round(v.material.base_color[3], 3) for v in door} == {0.5, 1.0}


def test_the_root_stands_upright_with_its_front_to_minus_x(awkward: Path) -> None:
    model = load(awkward)
    pose = forward_kinematics(model, np.zeros(4))[model.part_names.index("door_frame")]
    np.testing.assert_allclose(pose[:3, :3] @ [0, 1, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(pose[:3, :3] @ [0, 0, 1], [-1, 0, 0], atol=1e-12)


def test_a_path_to_the_file_works_as_any_urdf(awkward: Path) -> None:
    model = load_robot(awkward / "mobility.urdf")
    assert "link_0" in model.part_names and "joint_0" in model.joint_names
    assert any(v.material.texture is not None for v in model.visuals)
    here, named = (forward_kinematics(m, np.full(4, 0.1)) for m in (model, load(awkward)))
    np.testing.assert_array_equal(here, named)


def test_a_missing_mesh_stops_unless_that_is_allowed(awkward: Path) -> None:
    (awkward / "textured_objs" / "new-1.obj").unlink()
    with pytest.raises(ModelError, match=r"new-1\.obj.*missing.*--allow-missing"):
        load(awkward)
    model = load(awkward, allow_missing=True)
    assert any("new-1.obj" in note and "missing" in note for note in model.notes)
    assert model.visuals


def test_textures_come_from_the_objects_own_folder_only(awkward: Path) -> None:
    shutil.copy(awkward / "images" / "texture_0.jpg", awkward.parent / "secret.jpg")
    for name in ("original-1", "new-1"):
        (awkward / "textured_objs" / f"{name}.mtl").write_text(
            MTL.replace("../images/texture_0.jpg", "../../secret.jpg"))
    model = load(awkward)
    assert all(v.material.texture is None for v in model.visuals)
    assert any("secret.jpg" in note for note in model.notes)


@pytest.mark.parametrize(("text", "names"), [
    (None, {}), ("", {}), ("link_0 hinge\n\n  \nlink_1 heavy body extra\n", {}),
    ("link_0 hinge ../../door\nlink_1 heavy <b>\n", {}),
    ("link_0 hinge base\n", {"link_0": "base_2"}),
    ("link_0 hinge door\nlink_0 hinge lid\n", {"link_0": "door"}),
    ("link_0 hinge door\r\nlink_1 heavy door\r\n", {"link_0": "door", "link_1": "door_2"}),
    ("link_0 hinge door_2\nlink_1 hinge door\nlink_2 hinge door\n",
     {"link_0": "door_2", "link_1": "door", "link_2": "door_3"}),
])
def test_what_semantics_calls_parts(tmp_path: Path, text: str | None, names: dict[str, str]
                                    ) -> None:
    if text is not None:
        (tmp_path / "semantics.txt").write_bytes(text.encode())
    found = part_names(tmp_path)
    assert {k: v for k, v in found.items() if not k.endswith("_helper")} == names


def test_a_name_that_is_taken_is_refused(awkward: Path) -> None:
    (awkward / "semantics.txt").write_text("link_0 hinge link_3\n")
    with pytest.raises(ModelError, match=r"semantics\.txt: calls a link as another"):
        load(awkward)


def test_the_folder_is_where_sapien_looks(
    awkward: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(partnet.TOKEN, raising=False)
    monkeypatch.delenv(partnet.DATASET_VARIABLE, raising=False)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(GcbenchError, match=r"partnet:7310 is not in partnet-mobility-dataset; "
                                           r"set PARTNET_MOBILITY_DATASET .* SAPIEN_ACCESS_TOKEN"):
        load_robot("partnet:7310")
    shutil.copytree(awkward.parent, tmp_path / "partnet-mobility-dataset")
    assert load_robot("partnet:7310").name == "partnet:7310"
    monkeypatch.setenv(partnet.DATASET_VARIABLE, str(tmp_path / "elsewhere"))
    with pytest.raises(GcbenchError, match=r"not in .*elsewhere"):
        load_robot("partnet:7310")
    assert load_robot("partnet:7310", {"partnet": awkward.parent}).name == "partnet:7310"


def test_what_is_not_there_is_downloaded_by_sapien_and_tells_no_token(
    awkward: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With a stand-in of sapien's signature and manners: it prints the address with the token."""
    calls: list[tuple[str, str | None, str | None]] = []

    def download(model_id: str, token: str | None = None, directory: str | None = None) -> str:
        calls.append((model_id, token, directory))
        print("downloading from", f"https://example.org/{model_id}.zip?token={token}")
        if model_id != "7310":
            raise Exception(f"no such model at ?token={token}")
        shutil.copytree(awkward, Path(str(directory)) / model_id)
        return f"{directory}/{model_id}/mobility.urdf"

    asset = ModuleType("sapien.asset")
    vars(asset)["download_partnet_mobility"] = download
    package = ModuleType("sapien")
    package.__spec__ = io.__spec__
    monkeypatch.setitem(sys.modules, "sapien", package)
    monkeypatch.setitem(sys.modules, "sapien.asset", asset)
    monkeypatch.setenv(partnet.TOKEN, "s3cret")
    monkeypatch.setenv(partnet.DATASET_VARIABLE, str(tmp_path / "new"))
    with pytest.raises(GcbenchError, match="is not in"):  # to verify is to read
        robot_urdf("partnet:7310", download=False)
    assert load_robot("partnet:7310").name == "partnet:7310"
    load_robot("partnet:7310")
    assert calls == [("7310", "s3cret", str(tmp_path / "new"))]
    with pytest.raises(GcbenchError, match="sapien cannot download it") as caught:
        load_robot("partnet:1")
    said = capsys.readouterr()
    assert "s3cret" not in str(caught.value) + said.out + said.err


def test_without_sapien_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(partnet, "find_spec", lambda _: None)
    monkeypatch.setenv(partnet.TOKEN, "s3cret")
    monkeypatch.setenv(partnet.DATASET_VARIABLE, str(tmp_path))
    with pytest.raises(GcbenchError, match=r"pip install '\.\[sapien\]'"):
        load_robot("partnet:1")


def test_a_generated_folder_is_read_by_the_same_loader(tmp_path: Path) -> None:
    folder = tmp_path / "99"
    folder.mkdir()
    write_appliance("dishwasher", 99, folder)
    model = load_robot("partnet:99", {"partnet": tmp_path})
    assert scored_joints(model) == ("door",)
    assert {"body", "door", "rack", "rack_2"} <= set(model.part_names)
    (folder / "semantics.txt").unlink()
    plain = load_robot("partnet:99", {"partnet": tmp_path})
    assert scored_joints(plain) == () and "link_0" in plain.part_names
