"""Write a URDF, load it, render it, and verify the ground truth.

    python 02_own_robot.py --out data/crane --small
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gcbench as gb

CRANE = """<robot name="crane">
  <material name="yellow"><color rgba="0.9 0.7 0.1 1"/></material>
  <link name="base"><visual>
    <geometry><cylinder radius="0.2" length="0.2"/></geometry></visual></link>
  <link name="mast"><visual><origin xyz="0 0 0.4"/><geometry><box size="0.1 0.1 0.8"/></geometry>
    <material name="yellow"/></visual></link>
  <link name="jib"><visual><origin xyz="0.4 0 0"/><geometry><box size="0.9 0.08 0.08"/></geometry>
    <material name="yellow"/></visual></link>
  <link name="trolley"><visual><origin xyz="0 0 -0.1"/>
    <geometry><box size="0.12 0.16 0.2"/></geometry></visual></link>
  <joint name="slew" type="revolute"><parent link="base"/><child link="mast"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 0 1"/><limit lower="-3" upper="3"/></joint>
  <joint name="luff" type="revolute"><parent link="mast"/><child link="jib"/>
    <origin xyz="0 0 0.8"/><axis xyz="0 -1 0"/><limit lower="-0.2" upper="0.9"/></joint>
  <joint name="travel" type="prismatic"><parent link="jib"/><child link="trolley"/>
    <origin xyz="0.3 0 -0.08"/><axis xyz="1 0 0"/><limit lower="0" upper="0.4"/></joint>
</robot>
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("data/crane"))
    parser.add_argument("--small", action="store_true", help="few small images")
    options = parser.parse_args()

    urdf = options.out.with_name("crane.urdf")
    urdf.parent.mkdir(parents=True, exist_ok=True)
    urdf.write_text(CRANE)

    model = gb.load_robot(urdf)
    print("parts: ", *model.part_names)
    for name, kind in zip(model.joint_names, model.joint_types, strict=True):
        print("joint: ", name, kind)

    size = {"frames": 5, "width": 128, "height": 96} if options.small else {}
    config = gb.RenderConfig(robot=str(urdf), seed=3, scored_joints=("slew", "luff"), **size)
    gb.render_dataset(config, n=2 if options.small else 20, out=options.out)

    report = gb.verify_dataset(options.out, allow_model=True)
    print(report.table())
    print("verified" if report.ok else "NOT verified")


if __name__ == "__main__":
    main()
