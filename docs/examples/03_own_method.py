"""Evaluate your own method: the angle of a door from the centroid of the pixels that move.

    python 03_own_method.py --out data/doors --small
    gcbench eval --method 03_own_method.py:DoorAngle hold-still --data data/doors/microwave
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gcbench as gb
import numpy as np


class DoorAngle:
    """One revolute joint with a known axis line: follow the centroid of what moves about it."""

    name, version, training = "door-angle", "1", "none"
    inputs, knowledge = ("rgbd",), ("kinematics",)

    def estimate(self, observation: gb.Observation) -> gb.Estimate:
        depth, line = observation.depth, observation.axis_line[0]
        height, width = depth.shape[1:]
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
        pixels = np.concatenate([pixels, np.ones((height, width, 1))], axis=-1)
        rays = pixels @ np.linalg.inv(observation.intrinsics).T      # [H W 3] at depth 1

        still = depth.max(axis=0)                                    # the farthest surface seen
        axis, point = line[:3], np.cross(line[:3], line[3:])
        angles = np.zeros(len(depth))
        first = None
        for t, image in enumerate(depth):
            moving = (image > 0) & (image < still - 0.02)            # m in front of it
            if not moving.any():
                continue
            arm = (image[moving, None] * rays[moving]).mean(axis=0) - point
            arm -= axis * (axis @ arm)
            first = arm if first is None else first
            angles[t] = np.arctan2(axis @ np.cross(first, arm), first @ arm)
        displacement = np.zeros((len(depth), observation.n_joints))
        displacement[:, 0] = angles - angles[0]
        return gb.Estimate(displacement=displacement)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("data/doors"))
    parser.add_argument("--small", action="store_true", help="few small images")
    options = parser.parse_args()

    size = {"frames": 5, "width": 128, "height": 96} if options.small else {"frames": 16}
    data = options.out / "microwave"
    gb.render_dataset(gb.RenderConfig(robot="microwave", seed=1, **size),
                      n=2 if options.small else 20, out=data)

    methods = (f"{Path(__file__).resolve()}:DoorAngle", "hold-still")
    config = gb.EvalConfig(method=methods, data=(data,), results=options.out / "results")
    results = gb.evaluate(config)
    final = results.frame[results.frame.metric == "final_error"]
    print(final.groupby("method").value.describe()[["count", "mean", "50%", "max"]])
    print(*results.failures, sep="\n")


if __name__ == "__main__":
    main()
