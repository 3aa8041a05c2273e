"""Moving boxes before a wall, drawn by ray casting: observations with a known answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from gcbench.gcpose.chain.kinematics import part_motions, twists_of
from gcbench.renderer.types.observation import Observation
from gcbench.robots.geometry import inverse, rotation_from_rpy

STILL = np.eye(4)
HEIGHT, WIDTH, FRAMES = 180, 240, 8
INTRINSICS = np.array([[260.0, 0, 119.5], [0, 260.0, 89.5], [0, 0, 1]])
TILT = rotation_from_rpy([0.45, -0.6, 0.0])


Box = tuple[int, list[float], list[float]]


def cast(
    motion: np.ndarray, boxes: list[Box], world: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and part [T H W] of boxes (part, center, half size) before a wall at 3 m."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    ray = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(INTRINSICS).T
    depth = np.full((len(motion), HEIGHT, WIDTH), 3.0)
    part = np.zeros(depth.shape, int)
    for t in range(len(motion)):
        for j, center, half in boxes:
            box_from_cam = inverse(motion[t, j] @ world)
            o = box_from_cam[:3, 3] - np.array(center)
            d = ray @ box_from_cam[:3, :3].T
            with np.errstate(divide="ignore", invalid="ignore"):
                one, two = (-np.array(half) - o) / d, (np.array(half) - o) / d
            near, far = np.minimum(one, two).max(-1), np.maximum(one, two).min(-1)
            hit = (near < far) & (near > 0.1) & (near < depth[t])
            depth[t][hit], part[t][hit] = near[hit], j
    return np.round(depth, 4).astype(np.float32), part


Scene = tuple[Observation, np.ndarray, np.ndarray, np.ndarray]


def scene(
    kind: str, new_from_old: np.ndarray = STILL, pace: tuple[float, ...] = (1.0,)
) -> Scene:
    """An observation with known lines, the true displacement, screws and parts.

    `new_from_old` moves the camera, `pace` is a factor of the displacement of each joint.
    """
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = TILT, [0.0, 0.0, 1.3]
    world = new_from_old @ world
    tilt, origin = world[:3, :3], world[:3, 3]
    along, up, side = tilt.T
    time = np.linspace(0, 1, FRAMES)
    boxes: list[Box]
    parent: tuple[int, ...] = ()
    if kind in ("doors", "drawers", "door and drawer"):
        parent = (-1, -1)
        boxes = [(0, [0, 0.05, 0.16], [0.4, 0.3, 0.1]), (1, [-0.17, 0.05, 0], [0.16, 0.22, 0.03]),
                 (2, [0.17, 0, 0], [0.16, 0.22, 0.03])]
        prismatic = np.array([kind == "drawers", kind != "doors"])
        angle = np.stack([0.2 * time, 0.1 * time**1.5], axis=1)
        angle *= np.where(prismatic, 1.0, [4.0, -5.0])
        at = origin + np.array([[-0.33, 0, 0], [0.33, 0, 0]]) @ tilt.T
        turn = np.concatenate([up[None].repeat(2, axis=0), np.cross(at, up)], axis=1)
        slide = np.concatenate([-side, np.zeros(3)])
        screw = np.where(prismatic[:, None], slide, turn)
    elif kind == "slide":
        screw, prismatic = np.concatenate([along, np.zeros(3)])[None], np.array([True])
        angle = (0.15 * time)[:, None]
        boxes = [(0, [0, 0.2, 0], [0.25, 0.05, 0.1]), (1, [-0.1, 0.08, 0.02], [0.1, 0.07, 0.08])]
    else:
        base, elbow = origin + 0.3 * up, origin - 0.05 * up
        screw = np.stack([np.r_[up, np.cross(base, up)], np.r_[side, np.cross(elbow, side)]])
        prismatic = np.array([False, False])
        angle = np.stack([0.5 * time, -0.6 * time**1.3], axis=1)
        boxes = [(0, [0, 0.33, 0], [0.14, 0.04, 0.14]), (1, [0, 0.12, 0], [0.06, 0.16, 0.04]),
                 (2, [0.12, -0.08, 0], [0.2, 0.05, 0.06])]
    angle = angle * np.array(pace)
    parents = np.array(parent or range(-1, len(screw) - 1))
    motion = part_motions(twists_of(screw, prismatic), angle, parents)
    depth, part = cast(motion, boxes, world)
    rgb = np.repeat((60 + 50 * part)[..., None], 3, axis=-1).astype(np.uint8)
    observation = Observation(
        rgb, depth, INTRINSICS, time, len(screw),
        tuple("prismatic" if p else "revolute" for p in prismatic),
        parent, axis_direction=screw[:, :3], axis_line=screw,
    )
    return observation, angle, screw, part


def told(observation: Observation, knowledge: str) -> Observation:
    """The observation with no more than some knowledge."""
    if knowledge != "kinematics":
        observation = replace(observation, axis_line=None)
    return replace(observation, axis_direction=None) if knowledge == "free" else observation
