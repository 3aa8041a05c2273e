"""Robots of the package robot_descriptions, cloned from a local git repository."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import trimesh
from gcbench.__main__ import main
from gcbench.errors import ModelError
from gcbench.renderer.scene import RenderConfig, model_of, resolve
from gcbench.robots.catalog import descriptions, fetch_robot, load_robot, robot_urdf

from ...test_cli import Lines, one_line

PANDA = "rd:panda_description"
URL = "https://github.com/Gepetto/example-robot-data.git"
URDF = """<robot name="panda">
  <link name="base"><visual><geometry><mesh filename="{}"/></geometry></visual></link>
  <link name="hand"><visual><geometry><mesh filename="{}"/></geometry></visual></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="hand"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 0 1"/><limit lower="-2" upper="2"/></joint>
</robot>"""


def git(folder: Path, *args: str) -> str:
    command = ["git", "-c", "user.name=a", "-c", "user.email=a@b", *args]
    return subprocess.run(command, cwd=folder, check=True, capture_output=True,
                          text=True).stdout.strip()


@pytest.fixture
def upstream(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A repository that git clones in place of the one that robot_descriptions names."""
    pytest.importorskip("robot_descriptions")
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path / "own"))
    folder = tmp_path / "upstream"
    package = folder / "robots/panda_description"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    trimesh.creation.box((0.1, 0.1, 0.1)).export(package / "meshes/box.stl")
    (package / "urdf/panda.urdf").write_text(URDF.format(
        "package://example-robot-data/robots/panda_description/meshes/box.stl",
        "package://panda_description/meshes/box.stl"))
    git(folder, "init", "--quiet")
    git(folder, "add", ".")
    git(folder, "commit", "--quiet", "-m", "a panda")
    # the module's own variable for another commit than the pinned one
    monkeypatch.setenv("ROBOT_DESCRIPTION_COMMIT", git(folder, "rev-parse", "HEAD"))
    for key, value in (("COUNT", "1"), ("KEY_0", f"url.file://{folder}.insteadOf"),
                       ("VALUE_0", URL)):
        monkeypatch.setenv(f"GIT_CONFIG_{key}", value)
    descriptions.clone_robot.cache_clear()
    yield folder
    descriptions.clone_robot.cache_clear()


def test_a_description_is_cloned_once(upstream: Path) -> None:
    config = RenderConfig(PANDA)
    with pytest.raises(ModelError, match=rf"not on this machine \(gcbench robots fetch {PANDA}\)"):
        model_of(config)  # a dataset makes no command download anything
    model = load_robot(PANDA)
    assert (model.name, model.joint_names, model.licence) == (PANDA, ("turn",), "Apache-2.0")
    commit = git(upstream, "rev-parse", "HEAD")
    assert model.source.startswith(f"{PANDA}: robot_descriptions==")
    assert model.source.endswith(f"example-robot-data at {commit}")
    assert set(model.files) == {f"robots/panda_description/{name}"
                                for name in ("urdf/panda.urdf", "meshes/box.stl")}
    upstream.rename(upstream.with_name("gone"))  # from now on as without network
    descriptions.clone_robot.cache_clear()
    assert model_of(resolve(config)).source == model.source
    urdf = robot_urdf(PANDA)
    assert urdf is not None and urdf.is_relative_to(fetch_robot(PANDA) or "")


def test_a_clone_that_fails_is_one_line(upstream: Path, capsys: Lines) -> None:
    upstream.rename(upstream.with_name("gone"))
    assert main(["robots", "fetch", PANDA]) == 2
    said = one_line(capsys)
    assert f"cannot clone {PANDA} (" in said and "does not " in said
    assert "ROBOT_DESCRIPTIONS_CACHE" in said


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("rd:panda_descriptoin", r"perhaps you meant rd:panda_description\)"),
        ("rd:os.path", "no robot 'rd:os.path'"),
        ("rd:panda_mj_description", "MJCF"),
    ],
)
def test_a_name_that_cannot_be_meant(name: str, says: str, upstream: Path) -> None:
    with pytest.raises(ModelError, match=says):
        resolve(RenderConfig(name))


def test_a_xacro_is_told(upstream: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CONFIG_VALUE_0", "https://github.com/UniversalRobots/"
                       "Universal_Robots_ROS2_Description.git")
    with pytest.raises(ModelError, match=r"is a xacro file, .*ur\.urdf\.xacro: run `xacro"):
        load_robot("rd:ur5e_description")


def test_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    with pytest.raises(ModelError, match="not installed: pip install robot_descriptions"):
        load_robot(PANDA)
