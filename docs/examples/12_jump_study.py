"""How GC-Pose follows doors that jump: that move fast, turn back at once, or of which frames miss.

    python 12_jump_study.py --out data/jumps --small

Frames of rendered doors are left out or repeated in the opposite order. GC-Pose sees the images,
the field of view and the direction of the axis.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gcbench as gb
import numpy as np


def select_frames(frames: int) -> dict[str, list[int]]:
    """Return which frames of a door that opens make each kind of video."""
    every, half, last = list(range(frames)), frames // 2, frames - 1
    step = max(1, frames // 4)
    return {
        "opens": every,
        "misses a quarter": every[: half - 1] + every[half - 1 + step :],
        "slams": [*every, *range(last - step + 1, 0, -step)],
        "fast, there and back": [*every[::2], *every[last : 0 : -2], 0],
    }


def observe(sequence: gb.Sequence, chosen: list[int]) -> gb.Observation:
    """Return what GC-Pose sees of the chosen frames; these start at frame 0."""
    state, joint = sequence.state, sequence.meta.joint_names.index(sequence.meta.scored_joints[0])
    return gb.Observation(
        rgb=np.stack([sequence.rgb[t] for t in chosen]), depth=None, intrinsics=state.intrinsics,
        times=np.arange(len(chosen)) * state.times[1], n_joints=1, joint_types=("revolute",),
        axis_direction=state.joint_screw[0, joint : joint + 1, :3])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("data/jumps"))
    parser.add_argument("--n", type=int, default=12, help="number of doors of each kind")
    parser.add_argument("--seed", type=int, default=318862)
    parser.add_argument("--small", action="store_true", help="one sequence of few small images")
    options = parser.parse_args()

    size = {"frames": 8, "width": 160, "height": 120} if options.small else {"frames": 16}
    method = gb.GCPose()
    found: dict[str, list[tuple[float, bool]]] = {}
    for robot in ("microwave",) if options.small else ("microwave", "dishwasher", "oven"):
        out = options.out / robot
        gb.render_dataset(gb.RenderConfig(robot=robot, seed=options.seed, **size),
                          n=1 if options.small else options.n, out=out)
        for k, sequence in enumerate(gb.open_dataset(out)):
            joint = sequence.meta.joint_names.index(sequence.meta.scored_joints[0])
            position = sequence.state.joint_positions[:, joint]
            true = position - position[0]
            for name, chosen in select_frames(len(true)).items():
                estimate = method.estimate(observe(sequence, chosen))
                error = np.degrees(np.abs(estimate.displacement[:, 0] - true[chosen]))
                found.setdefault(name, []).append((error[-1], bool(estimate.reliable[0])))
                print(f"{robot} {k}, {name}: error {error[-1]:.2f} deg, largest of a frame "
                      f"{error.max():.2f} deg" + " (not reliable)" * (not estimate.reliable[0]),
                      flush=True)
    for name, each in found.items():
        error, reliable = np.array([e for e, _ in each]), np.array([r for _, r in each])
        print(f"{name}: {len(each)} videos, mean {error.mean():.2f} deg, over 10 deg "
              f"{np.sum(error > 10)}, of these reliable {np.sum((error > 10) & reliable)}, "
              f"not reliable in all {np.sum(~reliable)}")


if __name__ == "__main__":
    main()
