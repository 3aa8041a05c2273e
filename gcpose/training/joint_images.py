"""Depth images of objects with one joint, and the 22 numbers that describe such an object."""

# pyright: basic
from __future__ import annotations

from collections.abc import Sequence as Row
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...renderer.dataset import open_dataset
from ...renderer.types import Sequence, Stack
from ...robots.geometry import (
    Array,
    fit_depth,
    inverse,
    move_screw,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from ..networks.abbatematteo import AXIS, CONFIGURATION, GEOMETRY, POSE, RADIUS
from .config import ViewConfig
from .data import draw_place
from .depth_views import (
    MIRROR,
    SAME_VIEW,
    View,
    draw_view,
    fitted_intrinsics,
    joint_slides,
    view_depth,
)

_ALONG = 0.9  # cosine from which a direction is too near an axis
_ROUNDING = 1e-9  # a larger number of a quaternion has a sign


@dataclass(frozen=True)
class JointSample:
    """A depth image and the numbers that describe it."""

    depth: NDArray[np.float32]
    """[108 192] in units of 12 m"""
    numbers: NDArray[np.float32]
    """[22] (see `joint_numbers`)"""


def joint_numbers(sequence: Sequence) -> Array:
    """Return the numbers [T 22] that describe an object with one joint in each frame.

    The axis in the frame of the body that carries the joint: a point (3, m) and the unit
    quaternion (x, y, z, w) that turns x to its direction; the joint position (rad or m); the
    center of the moving part from that point, in the part's frame (3, m); the sizes of the body (3,
    m) and the least size of the part (m); the body's position (3, m) and quaternion in the camera
    frame. w is never negative.

    Raises:
        DatasetError: If the sequence has not one scored joint between two parts, or no
            coordinates.
    """
    meta, state = sequence.meta, sequence.state
    joints = [meta.joint_names.index(name) for name in meta.scored_joints]
    body = int(state.joint_parent_part[joints[0]]) - 1 if len(joints) == 1 else -1
    if body < 0:
        raise DatasetError(f"sequence {meta.name} has not one scored joint between two parts")
    if state.coordinate_box is None:
        raise DatasetError(f"sequence {meta.name} has no coordinates; render with "
                           "--layers coordinates")
    j, part = joints[0], int(state.joint_child_part[joints[0]]) - 1
    size = state.coordinate_box[:, 1] - state.coordinate_box[:, 0]
    cam_from_body = state.cam_from_world @ state.world_from_part[:, body]
    cam_from_part = state.cam_from_world @ state.world_from_part[:, part]
    axis = move_screw(inverse(cam_from_body), state.joint_screw[:, j], joint_slides(sequence))
    direction = axis[:, :3]
    point = np.cross(direction, axis[:, 3:])
    from_part = inverse(cam_from_part) @ cam_from_body
    on_axis = np.einsum("tij,tj->ti", from_part[:, :3, :3], point) + from_part[:, :3, 3]
    center = state.coordinate_box[part].mean(0) - on_axis
    frames = len(state.times)
    return np.concatenate([
        point, _quaternion(_turn_x_to(direction)), state.joint_positions[:, j, None], center,
        np.tile(np.append(size[body], size[part].min()), (frames, 1)),
        cam_from_body[:, :3, 3], _quaternion(cam_from_body[:, :3, :3]),
    ], axis=1)


def view_numbers(numbers: Array, view: View, slides: bool) -> Array:
    """Return the numbers [22] (see `joint_numbers`) in another view; the joint slides or turns.

    A mirror makes another object: it exchanges left and right of the body, too.
    """
    axis, pose = numbers[AXIS], numbers[POSE]
    direction, from_body = (rotation_from_quaternion(q) for q in (axis[3:], pose[3:]))
    mirror = MIRROR if view.mirrors else np.eye(3)
    along = mirror @ direction[:, 0] * (-1.0 if view.mirrors and not slides else 1.0)
    out = np.array(numbers, np.float64)
    out[CONFIGURATION] *= view.scale if slides else 1.0
    out[AXIS] = *view.scale * mirror @ axis[:3], *_quaternion(_turn_x_to(along[None]))[0]
    out[RADIUS] = view.scale * mirror @ numbers[RADIUS]
    out[GEOMETRY] *= view.scale
    turned = view.turn @ from_body @ mirror
    out[POSE] = *view.scale * view.turn @ pose[:3], *_quaternion(turned[None])[0]
    return out


def _turn_x_to(direction: Array) -> Array:
    """Return rotations [T 3 3] whose first column is the direction [T 3].

    Rounding does not decide between two of them: equal axes must have equal labels.
    """
    helper = np.eye(3)[np.argmax(np.abs(direction) < _ALONG, axis=1)]
    z: Array = np.cross(direction, helper)
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    return np.stack([direction, np.cross(z, direction), z], axis=-1)


def _quaternion(rotation: Array) -> Array:
    """Return unit quaternions [T 4] with w >= 0; where w is 0, the last other number is above 0."""
    found = quaternion_from_rotation(rotation)
    backward = found[:, ::-1]
    first = np.argmax(np.abs(backward) > _ROUNDING, axis=1)
    found[backward[np.arange(len(found)), first] < 0] *= -1
    return found


class JointImages:
    """Images of datasets; each epoch has every image once, in another order."""

    def __init__(
        self, folders: Row[Path], seed: int, dropped: float, views: ViewConfig = SAME_VIEW
    ) -> None:
        """Open datasets; `dropped` is the share of the pixels that are set to zero.

        Raises:
            DatasetError: If a sequence cannot be learned from (see `joint_numbers`).
        """
        self.seed, self.dropped, self.views = seed, dropped, views
        self._depth: list[Stack[np.float32]] = []  # decoded when indexed
        self._cameras: list[Array] = []
        self._slides: list[bool] = []
        self.numbers: list[NDArray[np.float32]] = []
        """[T 22] of each sequence"""
        for sequence in (s for folder in folders for s in open_dataset(folder)):
            self._depth.append(sequence.depth)
            self._cameras.append(fitted_intrinsics(sequence))
            self._slides.append(joint_slides(sequence))
            self.numbers.append(joint_numbers(sequence).astype(np.float32))
        starts = np.cumsum([0, *(len(n) for n in self.numbers)])
        self._starts, self._count = starts[:-1], int(starts[-1])

    def __len__(self) -> int:
        return self._count

    def bounds(self) -> NDArray[np.float32]:
        """Return the least and the greatest of each number [2 22]."""
        whole = np.concatenate(self.numbers)
        return np.stack([whole.min(0), whole.max(0)])

    def sample(self, number: int) -> JointSample:
        """Return the sample of any number."""
        rng, image = draw_place(self.seed, number, len(self))
        k = int(np.searchsorted(self._starts, image, side="right")) - 1
        frame = image - int(self._starts[k])
        depth, numbers = fit_depth(self._depth[k][frame : frame + 1]), self.numbers[k][frame]
        kept = rng.random(depth.shape[1:]) >= self.dropped
        if self.views != SAME_VIEW:
            view = draw_view(rng, self.views)
            depth = view_depth(depth, self._cameras[k], view)
            numbers = view_numbers(numbers, view, self._slides[k]).astype(np.float32)
        return JointSample(depth[0] * kept, numbers)
