"""Joints for a glTF model: the format has none, only nodes and bones that may turn.

Each bone or node that can be told to be a moving part gets one revolute joint through its origin:

* bones that move vertices, but for the roots of skeletons, which move everything;
* nodes that an animation moves, and nodes with a mesh that hang on another node with a mesh;
* in a file without any of these, the three largest meshes beside the largest one;
* of a single mesh, the whole: it turns about the vertical.

A joint's axis is the frame's axis that is nearest to being perpendicular to the bone (the way to
the next joint, or to the middle of what moves); something centred on its own origin, as a wheel,
turns about its thinnest side.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry import Array
from ..model import ArticulatedModel, Joint, JointType, deform_visual, forward_kinematics

LIMIT, SMALL_LIMIT = np.radians(35.0), np.radians(10.0)
"""rad to each side: of a joint, and of one that moves little (a finger, a jaw)."""
_SMALL = 0.1  # of the model's size
_CENTRED = 0.15  # of what moves: a mesh whose middle is nearer to its origin turns like a wheel
_MOST_LOOSE = 3
MAX_JOINTS = 100
"""Where more could move, those do that move most."""
_SEEN = 0.2  # of the model's size


@dataclass(frozen=True)
class _Boxes:
    """World boxes around what each part and all that hangs on it shows. P parts."""

    low: Array
    """[P 3] +inf where there is nothing"""
    high: Array
    """[P 3]"""

    def size(self, part: int) -> float:
        """m, diagonal; 0 for nothing"""
        extent = self.high[part] - self.low[part]
        return float(np.linalg.norm(extent)) if (extent >= 0.0).all() else 0.0


def invent_joints(
    model: ArticulatedModel, bones: Collection[int], animated: Collection[int],
    meshes: Collection[int],
) -> tuple[dict[str, Joint], str]:
    """Return the joints that the parts of a model without joints suggest, and a note.

    Args:
        model: The model; it has no joints yet.
        bones: Parts that are bones of skins.
        animated: Parts that an animation moves.
        meshes: Parts that carry a mesh of their own.

    Returns:
        The joint of each part that moves, by part name; and a note for the model.
    """
    poses = forward_kinematics(model, np.zeros(0))  # nothing moves yet
    boxes = _boxes(model, poses)
    shown = [p for p in range(1, len(model.parent)) if boxes.size(p) > 0.0]
    chosen = _articulated(model, shown, bones, animated, meshes)
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


def _articulated(
    model: ArticulatedModel, shown: Sequence[int], bones: Collection[int],
    animated: Collection[int], meshes: Collection[int],
) -> list[int]:
    """The parts that move against something."""
    held = np.zeros(len(model.parent), bool)  # a mesh is above
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
    """The axis [3] of a part's joint, in its frame; poses are [P 4 4]."""
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
    if length < _CENTRED * boxes.size(part):
        axis = int(np.argmin(np.round(extent / extent.max(), 3)))
    else:
        along = np.abs(bone) / length
        # of two that are perpendicular, the one along which more is seen: the hinge of a door
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
