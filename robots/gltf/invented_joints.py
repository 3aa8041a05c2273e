"""Heuristic joints for glTF models, because the format has nodes and bones but no joints.

Each of these bones and nodes gets one revolute joint through its origin:

* bones that move vertices, except the roots of skeletons;
* nodes that an animation moves, and nodes with a mesh below another node with a mesh;
* in a file without any of these, up to three of the largest meshes, after the largest one;
* in a file with a single mesh, the whole model, which turns about the vertical.

The joint axis is the frame axis most nearly perpendicular to the bone (the direction to the next
joint, or to the center of the moved surfaces). A part centered on its own origin, such as a wheel,
turns about the axis of its smallest extent.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry import Array
from ..model import ArticulatedModel, Joint, JointType, deform_visual, forward_kinematics

LIMIT, SMALL_LIMIT = np.radians(35.0), np.radians(10.0)
"""Joint limits, +-rad, of normal and of small parts (a finger, a jaw)."""
_SMALL = 0.1  # size of a small part, relative to the model
_CENTERED = 0.15  # largest offset of the center from the origin of a wheel, relative to its size
_MOST_LOOSE = 3
MAX_JOINTS = 100
"""Limit on joints per model; the parts with the largest surfaces are kept."""
_SEEN = 0.2  # smallest size of a further loose mesh, relative to the model


@dataclass(frozen=True)
class _Boxes:
    """World bounding boxes of each part with all parts below it. P parts."""

    low: Array
    """[P 3] m, +inf for parts without surface"""
    high: Array
    """[P 3] m, -inf for parts without surface"""

    def size(self, part: int) -> float:
        """Return the diagonal of a box, m; 0 for an empty one."""
        extent = self.high[part] - self.low[part]
        return float(np.linalg.norm(extent)) if (extent >= 0.0).all() else 0.0


def invent_joints(
    model: ArticulatedModel, bones: Collection[int], animated: Collection[int],
    meshes: Collection[int],
) -> tuple[dict[str, Joint], str]:
    """Propose joints for a model without joints.

    Args:
        model: Model without joints.
        bones: Parts that are bones of skins.
        animated: Parts that an animation moves.
        meshes: Parts with a mesh of their own.

    Returns:
        The joint of each moving part, by part name; and a note for the model.
    """
    poses = forward_kinematics(model, np.zeros(0))  # the model has no joints yet
    boxes = _boxes(model, poses)
    shown = [p for p in range(1, len(model.parent)) if boxes.size(p) > 0.0]
    chosen = _find_moving_parts(model, shown, bones, animated, meshes)
    chosen = sorted(sorted(chosen, key=lambda p: (-boxes.size(p), p))[:MAX_JOINTS])
    note = "a glTF file has no joints: each bone or node that moves got one through its origin"
    if not chosen:
        largest = sorted((p for p in shown if p in meshes), key=lambda p: (-boxes.size(p), p))
        chosen = sorted(p for k, p in enumerate(largest[1:1 + _MOST_LOOSE])
                        if k == 0 or boxes.size(p) >= _SEEN * boxes.size(0))
        note = "a glTF file has no joints: its largest meshes but one got one each"
    lines = {p: (_axis(model, poses, boxes, p, frozenset(chosen)), np.zeros(3)) for p in chosen}
    if not chosen and shown:
        top = shown[0]
        middle = (boxes.low[0] + boxes.high[0]) / 2.0
        pose = poses[top]
        axis = pose[:3, :3].T @ np.array([0.0, 0.0, 1.0])
        point = pose[:3, :3].T @ (middle - pose[:3, 3])
        lines = {top: (axis, point)}
        note = "a glTF file without parts that move: the whole turns about the vertical"
    joints: dict[str, Joint] = {}
    for p, (axis, point) in lines.items():
        limit = LIMIT if boxes.size(p) >= _SMALL * boxes.size(0) else SMALL_LIMIT
        limit = float(limit if chosen else np.pi)
        name = model.part_names[p]
        joints[name] = Joint(name, JointType.REVOLUTE, axis, point, (-limit, limit))
    return joints, note


def _find_moving_parts(
    model: ArticulatedModel, shown: Sequence[int], bones: Collection[int],
    animated: Collection[int], meshes: Collection[int],
) -> list[int]:
    """Return the parts that move relative to another part."""
    held = np.zeros(len(model.parent), bool)  # below a part with a mesh
    under_bone = np.zeros(len(model.parent), bool)
    for p in range(1, len(model.parent)):
        above = int(model.parent[p])
        held[p] = held[above] or above in meshes
        under_bone[p] = under_bone[above] or above in bones
    return [p for p in shown
            if (p in bones and under_bone[p]) or (p in animated and p not in bones)
            or (p in meshes and held[p])]


def _axis(
    model: ArticulatedModel, poses: Array, boxes: _Boxes, part: int, chosen: Collection[int]
) -> Array:
    """Return the joint axis [3] of a part in its frame; `poses` is world_from_part [P 4 4]."""
    pose = poses[part]
    origin, frame = pose[:3, 3], pose[:3, :3]
    middle = (boxes.low[part] + boxes.high[part]) / 2.0
    next_joints = [int(c) for c in np.flatnonzero(model.parent == part) if int(c) in chosen]
    if next_joints:
        largest = max(next_joints, key=lambda c: (boxes.size(c), -c))
        ahead = poses[largest, :3, 3]
        if np.linalg.norm(ahead - origin) > 0.05 * boxes.size(part):
            middle = ahead
    bone = frame.T @ (middle - origin)
    extent = np.abs(frame.T) @ (boxes.high[part] - boxes.low[part])
    length = float(np.linalg.norm(bone))
    if length < _CENTERED * boxes.size(part):
        axis = int(np.argmin(np.round(extent / extent.max(), 3)))
    else:
        along = np.abs(bone) / length
        # of the nearly perpendicular axes, take that of the largest extent: the hinge of a door
        square = along < along.min() + 0.1
        axis = int(np.argmax(np.where(square, np.round(extent / extent.max(), 3), -1.0)))
    return np.eye(3)[axis]


def _boxes(model: ArticulatedModel, poses: Array) -> _Boxes:
    low = np.full((len(model.parent), 3), np.inf)
    high = -low
    for visual in model.visuals:
        points, _ = deform_visual(visual, poses, None, model.morph_weights)
        low[visual.part] = np.minimum(low[visual.part], points.min(0))
        high[visual.part] = np.maximum(high[visual.part], points.max(0))
    for p in range(len(model.parent) - 1, 0, -1):
        above = int(model.parent[p])
        low[above] = np.minimum(low[above], low[p])
        high[above] = np.maximum(high[above], high[p])
    return _Boxes(low, high)
