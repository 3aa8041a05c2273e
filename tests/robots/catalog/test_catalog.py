"""The robots of the catalogue: real files, fetched, against facts that others published.

Without network the tests of the real robots are skipped, with the reason; never in CI.
"""

from __future__ import annotations

import doctest
import hashlib
import json
import os
import re
import shutil
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import gcbench
import numpy as np
import pytest
import trimesh
from gcbench.errors import GcbenchError, ModelError
from gcbench.robots.catalog import (
    CATALOG,
    entries,
    find_robot,
    is_file,
    is_local,
    load_robot,
    loading,
    robot_urdf,
    select_default_scored,
)
from gcbench.robots.catalog.entries import FetchedRobot, GeneratedRobot, robot_folder
from gcbench.robots.geometry import inverse, rotation_about, transform
from gcbench.robots.model import ArticulatedModel, forward_kinematics
from gcbench.robots.motion.collision import CollisionChecker
from gcbench.robots.motion.trajectory import default_scored_joints

HALF = np.pi / 2

# classic DH, Rz(theta + offset) Tz(d) Tx(a) Rx(alpha): rows of a, d, alpha, offset
DH = {
    "ur5": [(0, 0.089159, HALF, 0), (-0.42500, 0, 0, 0), (-0.39225, 0, 0, 0),
            (0, 0.10915, HALF, 0), (0, 0.09465, -HALF, 0), (0, 0.0823, 0, 0)],
    "iiwa14": [(0, 0.360, -HALF, 0), (0, 0, HALF, 0), (0, 0.420, HALF, 0), (0, 0, -HALF, 0),
               (0, 0.400, -HALF, 0), (0, 0, HALF, 0), (0, 0.126, 0, 0)],
    "irb2400": [(0.100, 0.615, -HALF, 0), (0.705, 0, 0, -HALF), (0.135, 0, -HALF, 0),
                (0, 0.755, HALF, 0), (0, 0, -HALF, 0), (0, 0.085, 0, np.pi)],
}
LIMITS = {
    "ur5": [360, 360, 180, 360, 360, 360],
    "iiwa14": [170, 120, 170, 120, 170, 120, 175],
    "irb2400": [180, (-100, 110), (-60, 65), 200, 120, 400],
}
BASE = {"ur5": "base", "iiwa14": "base_link", "irb2400": "base_link"}
# the URDFs write right angles with 12 digits: 5e-12 rad each
POSITION = {"ur5": 6e-12, "iiwa14": 1e-12, "irb2400": 1e-12}  # m
ROTATION = 2e-11
IIWA_OFFSET = 0.43624e-3  # m; along x at A2 and back at A4, in the wheel's file only


FETCHED = tuple(entry for entry in CATALOG if isinstance(entry, FetchedRobot))


@cache
def attempt(name: str) -> Path | GcbenchError:
    try:
        return robot_folder(find_robot(name))
    except GcbenchError as error:
        return error  # remembered, so that being offline is found out once


def fetched(name: str) -> Path:
    result = attempt(name)
    if isinstance(result, Path):
        return result
    if os.environ.get("CI") == "true":
        raise result
    pytest.skip(str(result))


def loaded(name: str) -> ArticulatedModel:
    fetched(name)
    return load_robot(name)


def dh_flange(name: str, q: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    for (a, d, alpha, offset), value in zip(DH[name], q, strict=True):
        pose = (pose @ transform(rotation_about([0, 0, 1], value + offset), [0, 0, d])
                @ transform(rotation_about([1, 0, 0], alpha), [a, 0, 0]))
    return pose


def flange_against_dh(name: str, model: ArticulatedModel) -> np.ndarray:
    """Differences [200 4 4] of the flange's pose at random positions."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, len(model.joint_names)))
    poses = forward_kinematics(model, q)
    base, flange = (model.part_names.index(part) for part in (BASE[name], "tool0"))
    expected = np.array([dh_flange(name, x) for x in q])
    return inverse(poses[:, base]) @ poses[:, flange] - expected


@pytest.mark.parametrize("name", list(DH))
def test_kinematics_are_those_of_the_published_dh_table(name: str) -> None:
    model = loaded(name)
    if name == "iiwa14":
        at_zero = model.parent_from_part_at_zero.copy()
        at_zero[:, 0, 3][np.isclose(np.abs(at_zero[:, 0, 3]), IIWA_OFFSET)] = 0.0
        model = replace(model, parent_from_part_at_zero=at_zero)
    difference = flange_against_dh(name, model)
    assert np.linalg.norm(difference[:, :3, 3], axis=1).max() < POSITION[name]
    assert np.abs(difference[:, :3, :3]).max() < ROTATION


def test_the_iiwa_of_the_wheel_is_off_by_its_known_offset_only() -> None:
    model = loaded("iiwa14")
    shifts = model.parent_from_part_at_zero[[model.part_names.index(f"link_{i}")
                                             for i in (2, 4)], 0, 3]
    np.testing.assert_allclose(shifts, [-IIWA_OFFSET, IIWA_OFFSET])
    distance = np.linalg.norm(flange_against_dh("iiwa14", model)[:, :3, 3], axis=1)
    assert distance.max() <= 2 * IIWA_OFFSET + 1e-12
    assert 0.5e-3 < distance.mean() < 0.7e-3


@pytest.mark.parametrize("name", list(DH))
def test_limits_are_those_of_the_data_sheet(name: str) -> None:
    expected = [x if isinstance(x, tuple) else (-x, x) for x in LIMITS[name]]
    np.testing.assert_allclose(np.rad2deg(loaded(name).limits), expected, atol=0.04)


@pytest.mark.parametrize("entry", FETCHED, ids=lambda entry: entry.name)
def test_the_model_is_what_the_catalogue_says(entry: FetchedRobot) -> None:
    model = loaded(entry.name)
    assert (model.name, model.licence, model.source) == (entry.name, entry.licence, entry.source)
    assert re.fullmatch("[0-9a-f]{64}", model.sha256)
    assert set(model.joint_types) <= {"revolute"} and len(model.joint_names) == entry.joints
    assert entry.scored == select_default_scored(entry.name, model) == default_scored_joints(model)
    assert not model.notes  # nothing missing, nothing frozen
    points = np.concatenate([v.vertices for v in model.visuals])
    assert np.isfinite(points).all() and 0.1 < np.ptp(points, axis=0).max() < 3.0  # metres


@pytest.mark.parametrize("entry", FETCHED, ids=lambda entry: entry.name)
def test_the_licence_is_on_disk_beside_the_files(entry: FetchedRobot) -> None:
    folder = fetched(entry.name)
    assert entry.licence_files
    texts = [(folder / path).read_text(encoding="utf-8") for path in entry.licence_files]
    word = {"BSD-3-Clause": "BSD", "MIT AND Apache-2.0": "MIT", "Apache-2.0": "Apache"}
    assert any(word[entry.licence] in text for text in texts)


@pytest.mark.parametrize("entry", FETCHED, ids=lambda entry: entry.name)
def test_the_fetched_folder_holds_the_robot_and_nothing_that_runs(entry: FetchedRobot) -> None:
    files = [path for path in fetched(entry.name).rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 15e6
    assert {path.suffix for path in files} <= {".urdf", ".dae", ".stl", ".xml", ".md", ""}


@pytest.mark.parametrize("name", list(DH))
def test_a_robot_does_not_touch_itself_at_rest_and_does_when_folded(name: str) -> None:
    model = loaded(name)
    checker = CollisionChecker(model)
    n = len(model.joint_names)
    assert checker.first_contact(forward_kinematics(model, np.zeros(n))[None], None) is None
    rng = np.random.default_rng(1)
    poses = forward_kinematics(model, rng.uniform(*np.clip(model.limits, -np.pi, np.pi).T,
                                                  (300, n)))
    assert checker.first_contact(poses, None) is not None
    floor = checker.groups.ground_height(poses)
    assert -0.01 < floor < 0.01  # an arm stands on its foot
    assert checker.first_contact(poses, floor) is not None


@pytest.mark.parametrize("entry", FETCHED, ids=lambda entry: entry.name)
def test_every_fetched_file_is_pinned(entry: FetchedRobot) -> None:
    folder = fetched(entry.name)
    pinned = json.loads((Path(loading.__file__).parent / "hashes.json").read_text())
    found = {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
             for path in folder.rglob("*") if path.is_file()}
    assert pinned[entry.files.name] == found
    read = load_robot(entry.name).files
    assert entry.urdf in read and read.items() < found.items()


@pytest.mark.parametrize("change", ["other", "broken", "absent"])
def test_a_changed_cache_is_refused(
        change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = fetched("ur5")
    copy = tmp_path / "robots" / folder.name
    shutil.copytree(folder, copy)
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path))
    assert load_robot("ur5").files == loaded("ur5").files
    mesh = next(copy.rglob("visual/forearm.dae"))
    text = mesh.read_text()
    if change == "absent":
        mesh.unlink()
    else:
        mesh.write_text(text + "\n" if change == "other" else text[:1000])
    with pytest.raises(ModelError, match=f"forearm.dae: .*; delete the folder {copy}, and gcbench"):
        load_robot("ur5")
    mesh.write_text(text)
    assert load_robot("ur5").files


def test_the_files_of_a_model_are_in_its_provenance(tmp_path: Path) -> None:
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    trimesh.creation.box().export(meshes / "box.stl")
    urdf = tmp_path / "one.urdf"
    urdf.write_text('<robot name="one"><link name="a"><visual><geometry><mesh '
                    'filename="meshes/box.stl"/></geometry></visual></link></robot>')
    files = load_robot(urdf).files
    assert files == {name: hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()
                     for name in ("meshes/box.stl", "one.urdf")}
    trimesh.creation.box((1, 1, 2)).export(meshes / "box.stl")
    assert load_robot(urdf).files["meshes/box.stl"] != files["meshes/box.stl"]


def test_a_textured_robot_is_the_same_files() -> None:
    plain, textured = find_robot("ur5"), find_robot("ur5-textured")
    assert plain.files == textured.files and (plain.textured, textured.textured) == (False, True)


def test_names_are_unique_and_pins_are_whole() -> None:
    assert len({entry.name for entry in CATALOG}) == len(CATALOG)
    for entry in FETCHED:
        assert re.fullmatch("[0-9a-f]{64}", entry.files.sha256) and entry.files.size > 1e6
        assert len(entry.scored) == 3 and entry.urdf in entry.files.keep
        assert set(entry.licence_files) <= set(entry.files.keep)


def test_an_unknown_name_lists_what_exists() -> None:
    with pytest.raises(GcbenchError, match="ur5, ur5-textured, iiwa14, irb2400"):
        find_robot("ur6")
    with pytest.raises(GcbenchError, match="ur5"):
        load_robot("ur6")


def test_a_path_is_loaded_without_the_catalogue(tmp_path: Path) -> None:
    path = tmp_path / "one.urdf"
    path.write_text('<robot name="one"><link name="a"><visual><geometry><box size="1 1 1"/>'
                    "</geometry></visual></link></robot>")
    for form in (path, str(path)):
        assert is_file(form) and load_robot(form).part_names == ("a",)
    assert not is_file("ur5")
    with pytest.raises(GcbenchError):
        load_robot(str(tmp_path / "absent.urdf"))


def test_whether_a_robot_is_there_is_known_without_fetching_it(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path))
    assert not any(is_local(entry) for entry in FETCHED)
    assert list(tmp_path.iterdir()) == []


def test_a_generated_model_needs_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path))
    entry = GeneratedRobot(name="made", maker="gcbench", title="model", joints=0, scored=(),
                      licence="MIT", builder="made:build")
    (tmp_path / "one.urdf").write_text('<robot name="one"><link name="a"/></robot>')
    model = load_robot(tmp_path / "one.urdf")
    monkeypatch.setitem(sys.modules, "gcbench.robots.made", SimpleNamespace(build=lambda: model))
    monkeypatch.setattr(entries, "CATALOG", (*CATALOG, entry))
    assert is_local(entry) and robot_urdf("made") is None
    model = load_robot("made")
    assert (model.name, model.licence, model.source) == ("made", "MIT", entry.source)


def test_the_examples_of_the_docstrings_hold() -> None:
    done = doctest.testmod(loading, extraglobs={"gb": gcbench})
    assert done.attempted and not done.failed


@pytest.mark.parametrize(("name", "message"), [
    ("arm.urdf.xacro", "is a xacro file: run `xacro FILE > robot.urdf`"),
    ("arm.xml", "MJCF"), ("arm.usd", "USD"), ("world.sdf", "SDF"),
    (Path("arm.step"), r"is no robot file; \.urdf, \.glb and \.gltf files are read"),
])
def test_a_format_that_is_not_read_is_named(name: str | Path, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        load_robot(name)


def test_nothing_is_downloaded_where_that_is_forbidden(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path))
    for read in (load_robot, robot_urdf):
        with pytest.raises(ModelError, match="gcbench robots fetch ur5"):
            read("ur5", download=False)
    assert list(tmp_path.iterdir()) == []


def test_packages_may_be_text(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(
        '<robot name="one"><link name="a"><visual><geometry>'
        '<mesh filename="package://arm/box.obj"/></geometry></visual></link></robot>')
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "box.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    model = load_robot(tmp_path / "arm.urdf", packages={"arm": str(folder)})
    assert len(model.visuals[0].faces) == 1
