"""What a metric may use of a sequence: the scored joints' motion and axes, and the parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Sequence, State
from ...robots.geometry import Array, inverse


@dataclass(frozen=True)
class Truth:
    """T frames, J scored joints from the base outward."""

    joint_names: tuple[str, ...]
    joint_types: tuple[str, ...]
    """[J] revolute, continuous or prismatic."""
    prismatic: NDArray[np.bool_]
    """[J]"""
    displacement: Array
    """[T J] since frame 0, rad or m."""
    screw: Array
    """[J 6] each joint's axis in the camera frame at frame 0; prismatic: (l, 0)."""
    origin: Array
    """[J 3] m, origin of the part that each joint moves, in the camera frame at frame 0."""
    label: NDArray[np.uint8]
    """[P + 1] by part number of the masks: 0 still, j what scored joint j is the last to move."""
    parent: tuple[int, ...]
    """[J] which scored joint carries each, -1 for none."""


def truth_of(sequence: Sequence) -> Truth:
    """The truth that the benchmark scores; decodes no image."""
    meta, state = sequence.meta, sequence.state
    scored = [meta.joint_names.index(name) for name in meta.scored_joints]
    scored.sort(key=lambda j: int(state.joint_child_part[j]))  # parents stand before children
    child = state.joint_child_part[scored]
    q = state.joint_positions[:, scored]
    label = part_labels(state, child)
    cam_from_part = state.cam_from_world[0] @ state.world_from_part[0]
    return Truth(
        joint_names=tuple(meta.joint_names[j] for j in scored),
        joint_types=tuple(meta.joint_types[j] for j in scored),
        prismatic=np.array([meta.joint_types[j] == "prismatic" for j in scored], bool),
        displacement=q - q[:1],
        screw=state.joint_screw[0, scored],
        origin=cam_from_part[child - 1, :3, 3].reshape(-1, 3),
        label=label,
        parent=tuple(int(label[p]) - 1 for p in state.joint_parent_part[scored]),
    )


def part_labels(state: State, child: NDArray[np.int64]) -> NDArray[np.uint8]:
    """[P + 1] labels, from the parts' motion: which scored joint's part each moves along with.

    child [J] are the part numbers that the scored joints move. A sequence does not store which
    fixed part hangs on which; but only scored joints move, so that what moves as one is one. A
    part that moves like none of them (a mimic joint drives it) goes to the one it is nearest to.
    """
    poses = state.world_from_part
    motion = poses @ inverse(poses[0])  # [T P 4 4] of a point of the world that rides on the part
    origin = np.append(poses[0, :, :3, 3], np.ones((poses.shape[1], 1)), axis=1)
    still = np.broadcast_to(np.eye(4), (len(poses), 4, 4))
    distances: list[Array] = []  # of each part to the motion of each label
    for candidate in (still, *(motion[:, c - 1] for c in child)):
        difference = motion - candidate[:, None]
        turned = np.abs(difference[..., :3, :3]).max((0, 2, 3))
        moved = np.abs(np.einsum("tpij,pj->tpi", difference, origin)[..., :3]).max((0, 2))
        distances.append(np.round(turned + moved, 6))
    label = np.append(0, np.argmin(distances, axis=0))
    label[child] = np.arange(1, len(child) + 1)  # also of a joint that does not move
    return label.astype(np.uint8)
