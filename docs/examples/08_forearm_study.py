"""How much the arm of a person who moves a door disturbs GC-Pose on plain video.

    python 08_forearm_study.py --out data/forearm --small

A forearm is drawn over rendered images, from the hand on the edge of the door to below the image.
The foreground `no-people` leaves it out; its network learned from other drawings.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import gcbench as gb
import numpy as np

RADIUS = 0.045  # of the wrist, m; the elbow has 1.5 times as much
HAND = 3.5  # length that is bare, wrists' radii
SKIN = np.array([[224, 172, 140], [198, 134, 100], [141, 85, 60]])


def follow_hand(sequence: gb.Sequence) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixel [T 2] and the depth [T], m, of a place far from the axis of the door."""
    state, depth = sequence.state, sequence.depth[0]
    joint = sequence.meta.joint_names.index(sequence.meta.scored_joints[0])
    part = int(state.joint_child_part[joint])
    v, u = np.nonzero(sequence.part[0] == part)
    pixels = np.stack([u, v, np.ones(len(u))])
    seen = (np.linalg.inv(state.intrinsics) @ pixels * depth[v, u]).T  # [N 3] m, in frame 0
    axis, moment = np.split(state.joint_screw[0, joint], 2)
    along = seen @ axis
    middle = np.abs(along - np.median(along)) < 0.15 * np.ptp(along)
    away = np.linalg.norm(np.cross(seen, axis) - moment, axis=1)  # from the axis
    held = seen[np.argmax(away * middle)]
    from_part = state.cam_from_world @ state.world_from_part[:, part - 1]
    place = from_part @ np.linalg.inv(from_part[0]) @ np.append(held, 1.0)
    image = place[:, :3] @ state.intrinsics.T
    return image[:, :2] / image[:, 2:], place[:, 2]


def with_forearm(sequence: gb.Sequence, rng: np.random.Generator) -> np.ndarray:
    """Return the images [T H W 3] with a hand, and a sleeve with a pattern."""
    images, (at, depth) = np.stack(list(sequence.rgb)), follow_hand(sequence)
    height, width = images.shape[1:3]
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    skin, sleeve = rng.choice(SKIN), rng.integers(20, 200, 3)
    elbow = np.array([width * (0.5 + rng.choice([-1, 1]) * rng.uniform(0.1, 0.45)), 1.25 * height])
    for t, hand in enumerate(at):
        end = elbow + 0.15 * (hand - at[0]) + rng.normal(0, 3, 2)  # it sways
        length = np.linalg.norm(end - hand)
        direction = (end - hand) / length
        from_hand = pixels - hand
        along, across = from_hand @ direction, from_hand @ (direction[::-1] * [-1, 1])
        wrist = RADIUS * sequence.state.intrinsics[0, 0] / depth[t]
        radius = wrist * (1 + 0.5 * np.clip(along / length, 0, 1))
        inside = (along >= 0) & (np.abs(across) < radius)
        inside |= np.linalg.norm(from_hand, axis=-1) < 1.15 * wrist
        cover = cv2.GaussianBlur(inside.astype(np.float64), (0, 0), 0.7)[..., None]
        pattern = 1 + 0.12 * np.sin(along / 4) * np.sin(across / 3)
        bare = (along < HAND * wrist)[..., None]
        shade = np.clip(1 - 0.45 * (across / radius) ** 2, 0.3, 1)[..., None]
        color = np.where(bare, skin, sleeve * pattern[..., None]) * shade
        images[t] = np.clip(images[t] * (1 - cover) + color * cover, 0, 255)
    return images


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
    parser.add_argument("--out", type=Path, default=Path("data/forearm"))
    parser.add_argument("--n", type=int, default=12, help="sequences of each appliance")
    parser.add_argument("--seed", type=int, default=780013)
    parser.add_argument("--small", action="store_true", help="one sequence of few small images")
    options = parser.parse_args()

    methods = {name: gb.GCPose(foreground=name) for name in ("network", "no-people")}
    size = {"frames": 5, "width": 160, "height": 120} if options.small else {"frames": 16}
    for robot in ("microwave", "dishwasher", "oven")[: 1 if options.small else 3]:
        data = options.out / robot
        gb.render_dataset(gb.RenderConfig(robot=robot, seed=options.seed, **size),
                          n=1 if options.small else options.n, out=data)
        for k, sequence in enumerate(gb.open_dataset(data)):
            images = with_forearm(sequence, np.random.default_rng(k))
            cv2.imwrite(str(options.out / f"{robot}-{k}.png"), images[len(images) // 2, ..., ::-1])
            errors = {
                f"{shown}, {name}": estimate(sequence, video, method)
                for shown, video in (("alone", np.stack(list(sequence.rgb))), ("forearm", images))
                for name, method in methods.items()}
            print(f"{robot} {k}:", *(f"{name} {error};" for name, error in errors.items()),
                  flush=True)


if __name__ == "__main__":
    main()
