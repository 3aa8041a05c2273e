"""How far drawers slide on plain video, if only their distance from the camera is known.

    python 09_drawer_study.py --out data/drawer --small

GC-Pose sees the images and the field of view, and the depth of the drawer in the first frame: the
median over the pixels that move with it. `--axes` also gives the direction of the slide.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gcbench as gb
import numpy as np


def measure_depth(sequence: gb.Sequence, joint: int) -> float:
    """Return the median depth, m, in frame 0, of what a joint moves."""
    part = int(sequence.state.joint_child_part[joint])
    return float(np.median(sequence.depth[0][sequence.part[0] == part]))


def estimate(sequence: gb.Sequence, method: gb.GCPose, axes: bool) -> tuple[float, float, bool]:
    """Return how far a drawer slides until the last frame, and the error of the estimate, m, and
    whether GC-Pose calls it reliable."""
    state = sequence.state
    joint = sequence.meta.joint_names.index(sequence.meta.scored_joints[0])
    axis = state.joint_screw[0, joint : joint + 1, :3]
    found = method.estimate(gb.Observation(
        rgb=np.stack(list(sequence.rgb)), depth=None, intrinsics=state.intrinsics,
        times=state.times, n_joints=1, joint_types=("prismatic",),
        axis_direction=axis if axes else None), measure_depth(sequence, joint))
    true = state.joint_positions[-1, joint] - state.joint_positions[0, joint]
    sign = 1.0
    if not axes and found.screw is not None:  # of the axis, which may point either way
        sign = 1.0 if found.screw[0, :3] @ axis[0] > 0 else -1.0
    error = abs(sign * found.displacement[-1, 0] - true)
    return abs(float(true)), float(error), bool(found.reliable[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("data/drawer"))
    parser.add_argument("--n", type=int, default=100, help="number of drawers")
    parser.add_argument("--seed", type=int, default=660077)
    parser.add_argument("--axes", action="store_true", help="give the direction of the slide")
    parser.add_argument("--small", action="store_true", help="one sequence of few small images")
    options = parser.parse_args()

    size = {"frames": 5, "width": 160, "height": 120} if options.small else {"frames": 16}
    gb.render_dataset(gb.RenderConfig(robot="drawer", seed=options.seed, **size),
                      n=1 if options.small else options.n, out=options.out)
    method, errors = gb.GCPose(), []
    for k, sequence in enumerate(gb.open_dataset(options.out)):
        true, error, reliable = estimate(sequence, method, options.axes)
        errors.append(100 * error)
        print(f"{k}: slide {100 * true:.1f} cm, error {100 * error:.2f} cm"
              + " (not reliable)" * (not reliable), flush=True)
    print(f"mean {np.mean(errors):.2f} cm, median {np.median(errors):.2f} cm")


if __name__ == "__main__":
    main()
