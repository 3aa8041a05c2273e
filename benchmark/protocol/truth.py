"""Ground truth for the metrics: motion and axes of the scored joints, and part labels."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Sequence, State
from ...robots.geometry import Array, inverse


@dataclass(frozen=True)
class Truth:
    """Ground truth of a sequence of T frames with J scored joints, from the base outward."""

    joint_names: tuple[str, ...]
    joint_types: tuple[str, ...]
    """[J] revolute, continuous or prismatic."""
    prismatic: NDArray[np.bool_]
    """[J] True for prismatic joints."""
    displacement: Array
    """[T J] displacement since frame 0, rad or m."""
    screw: Array
    """[J 6] joint axes in the camera frame at frame 0; (l, 0) for prismatic joints."""
    origin: Array
    """[J 3] origin of the child part of each joint, in the camera frame at frame 0, m."""
    label: NDArray[np.uint8]
    """[P + 1] by part number in masks: 0 static, j = 1 .. J last scored joint before the part."""
    parent: tuple[int, ...]
    """[J] index of the parent scored joint, -1 for none."""
    pixels: NDArray[np.int64]
    """[J] fewest pixels in a frame of all that the joint moves."""


def truth_of(sequence: Sequence) -> Truth:
    """Return the ground truth of a sequence; no image is decoded."""
    meta, state = sequence.meta, sequence.state
    scored = [meta.joint_names.index(name) for name in meta.scored_joints]
    scored.sort(key=lambda j: int(state.joint_child_part[j]))  # parents before children
    child = state.joint_child_part[scored]
    q = state.joint_positions[:, scored]
    label = part_labels(state, child)
    parent = tuple(int(label[p]) - 1 for p in state.joint_parent_part[scored])
    cam_from_part = state.cam_from_world[0] @ state.world_from_part[0]
    return Truth(
        joint_names=tuple(meta.joint_names[j] for j in scored),
        joint_types=tuple(meta.joint_types[j] for j in scored),
        prismatic=np.array([meta.joint_types[j] == "prismatic" for j in scored], bool),
        displacement=q - q[:1],
        screw=state.joint_screw[0, scored],
        origin=cam_from_part[child - 1, :3, 3].reshape(-1, 3),
        label=label,
        parent=parent,
        pixels=fewest_pixels(state.part_pixels, label, parent),
    )


def fewest_pixels(
    part_pixels: NDArray[np.int64], label: NDArray[np.uint8], parent: tuple[int, ...]
) -> NDArray[np.int64]:
    """Return [J] the fewest pixels in a frame of the parts that each scored joint moves, from the
    pixels [T P] and labels [P + 1] of the parts, and the parents [J] of the joints."""
    shown = np.zeros((len(part_pixels), len(parent)), np.int64)
    for j in reversed(range(len(parent))):
        shown[:, j] += part_pixels[:, label[1:] == j + 1].sum(1)
        if parent[j] >= 0:
            shown[:, parent[j]] += shown[:, j]
    return shown.min(0)


def truth_digest(sequence: Sequence) -> str:
    """Return a hash of all that the scores of a sequence depend on, except its part masks."""
    meta, state = sequence.meta, sequence.state
    names = (meta.scored_joints, meta.joint_names, meta.joint_types, meta.frames)
    digest = hashlib.sha256(repr(names).encode())
    for array in (state.joint_positions, state.joint_screw, state.joint_child_part,
                  state.joint_parent_part, state.world_from_part, state.cam_from_world):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()[:32]


def part_labels(state: State, child: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return labels [P + 1]: the scored joint with which each part moves, 0 for static parts.

    child [J] are the child part numbers of the scored joints. A sequence does not store the fixed
    joints, so parts are grouped by equal motion. A part with another motion (of a mimic joint)
    gets the label of the most similar motion.
    """
    poses = state.world_from_part
    motion = poses @ inverse(poses[0])  # [T P 4 4] since frame 0, in the world frame
    origin = np.append(poses[0, :, :3, 3], np.ones((poses.shape[1], 1)), axis=1)
    still = np.broadcast_to(np.eye(4), (len(poses), 4, 4))
    distances: list[Array] = []  # [P] for each label: to the motion of that label
    for candidate in (still, *(motion[:, c - 1] for c in child)):
        difference = motion - candidate[:, None]
        turned = np.abs(difference[..., :3, :3]).max((0, 2, 3))
        moved = np.abs(np.einsum("tpij,pj->tpi", difference, origin)[..., :3]).max((0, 2))
        distances.append(np.round(turned + moved, 6))
    label = np.append(0, np.argmin(distances, axis=0))
    label[child] = np.arange(1, len(child) + 1)  # also where a joint does not move
    return label.astype(np.uint8)
