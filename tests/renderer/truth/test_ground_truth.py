"""Real renders against a second opinion that shares no code with us (`independent.py`)."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from gcbench.robots.catalog import find_robot, is_local
from gcbench.robots.catalog.entries import robot_folder

pytest.importorskip("embreex", reason="the second opinion casts rays with Embree")

from ...support import independent  # needs embreex

pytestmark = pytest.mark.gl

# Boxes, a cylinder and a sphere, an STL in millimetres (scaled in the URDF), a COLLADA file in
# centimetres with its y up; a revolute, a continuous, a prismatic and a mimicking joint.
CRANE = """<robot name="crane">
  <link name="foot">
    <visual><origin xyz="0 0 0.03"/><geometry><box size="0.4 0.3 0.06"/></geometry></visual>
  </link>
  <joint name="turn" type="continuous"><parent link="foot"/><child link="mast"/>
    <origin xyz="0.02 0 0.065" rpy="0 0 0.3"/><axis xyz="0 0 1"/></joint>
  <link name="mast">
    <visual><origin xyz="0 0 0.15" rpy="0 0 0.2"/><geometry><box size="0.16 0.12 0.3"/></geometry>
    </visual>
    <visual><origin xyz="0.03 0.11 0.1" rpy="1.2 0 0"/><geometry>
      <cylinder radius="0.02" length="0.1"/></geometry></visual>
  </link>
  <joint name="lift" type="revolute"><parent link="mast"/><child link="boom"/>
    <origin xyz="0 0 0.36" rpy="0 -0.2 0"/><axis xyz="0 -2 0"/>
    <limit lower="-0.3" upper="1.3" effort="1" velocity="1"/></joint>
  <link name="boom">
    <visual><origin xyz="0.25 0 0"/><geometry>
      <mesh filename="beam.stl" scale="0.001 0.001 0.001"/></geometry></visual>
    <visual><origin xyz="0.1 0 0.05"/><geometry><sphere radius="0.02"/></geometry></visual>
  </link>
  <joint name="reach" type="prismatic"><parent link="boom"/><child link="jib"/>
    <origin xyz="0.52 0 0" rpy="0.4 0 0"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>
  <link name="jib">
    <visual><geometry><mesh filename="jib.dae"/></geometry></visual>
  </link>
  <joint name="level" type="revolute"><parent link="jib"/><child link="hook"/>
    <origin xyz="0.13 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
    <mimic joint="lift" multiplier="0.5" offset="0.1"/></joint>
  <link name="hook">
    <visual><origin xyz="0.08 0 0"/><geometry><box size="0.12 0.1 0.1"/></geometry></visual>
  </link>
</robot>"""

# A box of 20 x 12 x 8 cm, shifted by its node, whose numbers are centimetres.
JIB = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
  <library_geometries><geometry id="g"><mesh>
    <source id="p"><float_array id="f" count="24">{positions}</float_array><technique_common>
      <accessor source="#f" count="8" stride="3"><param name="X" type="float"/>
      <param name="Y" type="float"/><param name="Z" type="float"/></accessor>
    </technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{faces}</p>
    </triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="s"><node id="n">
    <translate>0.5 0 0.25</translate><instance_geometry url="#g"/></node></visual_scene>
  </library_visual_scenes>
  <scene><instance_visual_scene url="#s"/></scene>
</COLLADA>"""


@pytest.fixture
def crane(tmp_path):
    import trimesh

    beam = trimesh.creation.box([500.0, 80.0, 60.0])
    beam.apply_translation([0.0, 5.0, 0.0])
    beam.export(tmp_path / "beam.stl")
    jib = trimesh.creation.box([20.0, 12.0, 8.0])
    (tmp_path / "jib.dae").write_text(JIB.format(
        positions=" ".join(f"{x:g}" for x in jib.vertices.ravel()),
        faces=" ".join(str(i) for i in jib.faces.ravel())))
    path = tmp_path / "crane.urdf"
    path.write_text(CRANE)
    return path


@pytest.fixture
def ur5():
    entry = find_robot("ur5")
    if not is_local(entry):
        pytest.skip("the UR5 has not been fetched")
    return robot_folder(entry) / entry.urdf


def gcbench(*arguments) -> str:
    run = subprocess.run([sys.executable, "-m", "gcbench", *map(str, arguments)], check=False,
                         capture_output=True, text=True, timeout=600, env={**os.environ})
    assert run.returncode == 0, run.stderr
    return run.stdout


def opinions(dataset: Path, urdf: Path) -> list[independent.Opinion]:
    robot = independent.load_robot(urdf)
    files = sorted((dataset / "sequences").glob("*.zip"))
    assert len(files) == 2
    return [independent.examine(f, robot, np.random.default_rng(0)) for f in files]


def agree(opinion: independent.Opinion):
    say = opinion.summary()
    assert len(opinion.depth) > 1000 and len(opinion.flow) > 1000, say
    assert np.quantile(opinion.depth, 0.999) < max(2e-4, 0.6 * opinion.depth_unit), say
    assert np.quantile(opinion.flow, 0.999) < 0.02, say
    assert np.quantile(opinion.flow_backward, 0.999) < 0.02, say
    assert opinion.part_equal.mean() >= 0.999, say
    assert opinion.background.mean() >= 0.999, say
    assert opinion.position < 1e-6 and opinion.rotation < 1e-6, say


@pytest.mark.parametrize("name", ["ur5", "crane"])
def test_render_agrees_with_rays_and_kinematics_of_others(name, request, tmp_path):
    urdf = request.getfixturevalue(name)
    out = tmp_path / "dataset"
    robot = name if name == "ur5" else urdf
    gcbench("render", "--robot", robot, "--n", 2, "--seed", 7, "--out", out, "--frames", 4)
    for opinion in opinions(out, urdf):
        agree(opinion)
    table = gcbench("verify", out, "--allow-model")
    assert "flow forward" in table and "FAIL" not in table


def test_the_second_opinion_can_disagree(crane, tmp_path):
    """Half a millimetre in one origin of the URDF is seen in poses, depth and flow or parts."""
    out = tmp_path / "dataset"
    gcbench("render", "--robot", crane, "--n", 2, "--seed", 7, "--out", out, "--frames", 4)
    other = crane.with_name("other.urdf")
    other.write_text(CRANE.replace('xyz="0 0 0.36"', 'xyz="0 0.0005 0.3605"'))
    for opinion in opinions(out, other):
        assert opinion.position > 1e-4
        assert np.quantile(opinion.depth, 0.9) > 2e-4, opinion.summary()
