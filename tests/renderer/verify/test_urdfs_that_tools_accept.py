"""`verify` accepts what was rendered from URDFs with parts that do not matter to it."""

from __future__ import annotations

from pathlib import Path

import pytest
from gcbench.renderer.generate.driver import render_dataset
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.verify import verify_dataset

URDF = """<robot NAME>
<link name="base"><visual><geometry><box size="0.5 0.1 0.1"/></geometry></visual>BASE</link>
<link name="arm"><visual><origin xyz="0.4 0 0.2"/><geometry><box size="0.8 0.1 0.1"/></geometry>
</visual>ARM</link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="1" velocity="VELOCITY"/></joint>JOINTS</robot>"""
PLAIN = {"NAME": 'name="odd"', "BASE": "", "ARM": "", "VELOCITY": "1", "JOINTS": ""}
CASES = {
    "an empty collision": {"ARM": "<collision/>"},
    "a plane": {"BASE": '<collision><geometry><plane normal="0 0 1"/></geometry></collision>'},
    "an inertia that is no number": {
        "ARM": '<inertial><mass value="1"/><inertia ixx="n/a" ixy="0" ixz="0" iyy="1" iyz="0" '
               'izz="1"/></inertial>'},
    "a placeholder of xacro": {"VELOCITY": "${v}"},
    "a robot without a name": {"NAME": ""},
    "a parent that is not declared": {"JOINTS": '<joint name="hold" type="fixed">'
        '<parent link="body"/><child link="base"/></joint>'},
    "an angle too many": {"JOINTS": '<link name="tip"/><joint name="end" type="fixed">'
        '<parent link="arm"/><child link="tip"/><origin rpy="0.1 0.2 0.3 0"/></joint>'},
}


@pytest.mark.gl
@pytest.mark.parametrize("case", CASES)
@pytest.mark.ci
def test_a_rendered_dataset_is_verified(case: str, tmp_path: Path) -> None:
    text = URDF
    for word, value in (PLAIN | CASES[case]).items():
        text = text.replace(word, value)
    (tmp_path / "odd.urdf").write_text(text)
    config = RenderConfig(robot=str(tmp_path / "odd.urdf"), frames=3, width=48, height=36)
    render_dataset(config, 1, tmp_path / "out", 1, progress=False)
    report = verify_dataset(tmp_path / "out", progress=False)
    assert "--allow-model" in report.warnings[0]  # a dataset may name any file
    report = verify_dataset(tmp_path / "out", progress=False, allow_model=True)
    assert report.ok, report.table()
    assert not report.warnings
    assert any(check.name.startswith("poses from the URDF") for check in report.checks)
