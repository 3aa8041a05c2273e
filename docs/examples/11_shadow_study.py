"""How much shadows that move disturb GC-Pose on plain video.

    python 11_shadow_study.py --out data/shadow --small

Two soft shadows are drawn over rendered doors. What they pass over changes, but stays where it is.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import gcbench as gb
import numpy as np


def with_shadows(images: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return images [T H W 3] with two soft shadows, each of which moves straight on."""
    frames, height, width = images.shape[:3]
    out = images.astype(np.float32)
    for _ in range(2):
        middle = rng.uniform(0.2, 0.8, 2) * [width, height]
        to = rng.uniform(0, 2 * np.pi)
        path = np.array([np.cos(to), np.sin(to)]) * rng.uniform(0.15, 0.5) * width
        axes = rng.uniform([0.12, 0.2], [0.35, 0.55]) * width  # of an ellipse, px
        tilt, light = rng.uniform(0, 180), rng.uniform(0.4, 0.75)
        blur = rng.uniform(0.012, 0.05) * width
        for t in range(frames):
            u, v = middle + path * (t / (frames - 1) - 0.5)
            shape = (float(u), float(v)), (float(axes[0]), float(axes[1])), tilt
            shadow = cv2.ellipse(np.zeros((height, width), np.float32), shape, 1.0, -1)
            out[t] *= 1 - (1 - light) * cv2.GaussianBlur(shadow, (0, 0), blur)[..., None]
    return out.astype(np.uint8)


def estimate(sequence: gb.Sequence, images: np.ndarray, method: gb.GCPose) -> str:
    """Return the error of the last frame, and whether GC-Pose calls it reliable, as text."""
    state = sequence.state
    joint = sequence.meta.joint_names.index(sequence.meta.scored_joints[0])
    found = method.estimate(gb.Observation(
        rgb=images, depth=None, intrinsics=state.intrinsics, times=state.times, n_joints=1,
        joint_types=("revolute",), cam_from_world=state.cam_from_world[0],
        axis_direction=state.joint_screw[0, joint : joint + 1, :3]))
    true = state.joint_positions[-1, joint] - state.joint_positions[0, joint]
    error = float(np.degrees(abs(found.displacement[-1, 0] - true)))
    return f"{error:.2f} deg" + " (not reliable)" * (not found.reliable[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("data/shadow"))
    parser.add_argument("--n", type=int, default=34, help="sequences of each appliance")
    parser.add_argument("--seed", type=int, default=390271)
    parser.add_argument("--small", action="store_true", help="one sequence of few small images")
    options = parser.parse_args()

    method = gb.GCPose(foreground="no-people")
    size = {"frames": 5, "width": 160, "height": 120} if options.small else {"frames": 16}
    for robot in ("microwave", "dishwasher", "oven")[: 1 if options.small else 3]:
        data = options.out / robot
        gb.render_dataset(gb.RenderConfig(robot=robot, seed=options.seed, **size),
                          n=1 if options.small else options.n, out=data)
        for k, sequence in enumerate(gb.open_dataset(data)):
            images = with_shadows(np.stack(list(sequence.rgb)), np.random.default_rng(k))
            cv2.imwrite(str(options.out / f"{robot}-{k}.png"), images[len(images) // 2, ..., ::-1])
            print(f"{robot} {k}: {estimate(sequence, images, method)}", flush=True)


if __name__ == "__main__":
    main()
