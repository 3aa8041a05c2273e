"""Drawings on photographs: joint axes, keypoints and tracks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, pinhole
from ..types import Meta, State
from .colors import RgbImage, palette
from .labels import Labels

_TRAIL = 8  # frames of a track's past that its trail shows
_MOST_TRACKS = 100  # drawn at once; of more, evenly spread ones


@dataclass(frozen=True)
class Axis:
    """A joint's axis in the image, px. None of the points need lie inside it."""

    joint: int
    """0-based"""
    tail: tuple[float, float]
    head: tuple[float, float]
    """(u, v); the direction tail -> head is that of a positive motion."""
    point: tuple[float, float]
    """Where the axis passes nearest to the child part's origin."""


def joint_axes(meta: Meta, state: State, t: int) -> list[Axis]:
    """Each joint's axis in frame t; a joint whose axis is behind the camera has none.

    The piece that is drawn is as long in metres as 0.4 of the image's height is at the
    object's distance in the first frame: it turns and comes nearer as the object does.
    """
    depth = (state.cam_from_world[0] @ state.world_from_part[0, :, :, 3].T)[2]
    distance = float(np.median(depth[depth > 0])) if (depth > 0).any() else 1.0
    half = 0.2 * distance * meta.height / state.intrinsics[1, 1]
    out: list[Axis] = []
    for j, (near_child, direction) in enumerate(zip(*axis_lines(meta, state, t), strict=True)):
        if not near_child[2] > 0.02 * distance:  # also where the pose is NaN
            continue
        # Cut where the line would pass through the camera's plane, behind which nothing projects.
        cut = abs(0.9 * near_child[2] / direction[2]) if direction[2] else np.inf
        reach = direction * min(half, cut)
        points = near_child + np.stack([-reach, 0.0 * reach, reach])
        uv = pinhole.project(state.intrinsics, points)[:, :2]
        tail, point, head = ((float(u), float(v)) for u, v in uv)
        out.append(Axis(j, tail, head, point))
    return out


def axis_lines(meta: Meta, state: State, t: int) -> tuple[Array, Array]:
    """Return a point [J 3] m and the direction [J 3] of each joint's axis in the camera at frame t.

    The point is the one that is nearest to the child part's origin.
    """
    child = state.cam_from_world[t] @ state.world_from_part[t, state.joint_child_part - 1, :, 3].T
    points, direction = child[:3].T, state.joint_screw[t, :, :3]
    on_axis = np.cross(direction, state.joint_screw[t, :, 3:])
    along = ((points - on_axis) * direction).sum(axis=-1, keepdims=True)
    prismatic = np.array([kind == "prismatic" for kind in meta.joint_types], bool)
    return np.where(prismatic[:, None], points, on_axis + along * direction), direction


def draw_axes(
    rgb: RgbImage, meta: Meta, state: State, t: int, scored_only: bool = False
) -> RgbImage:
    """A copy of `rgb` [H W 3] with the joints' axes of frame t: arrows in the child part's colour.

    `rgb` may be smaller or larger than the sequence's own size.
    """
    import cv2

    out = np.ascontiguousarray(rgb).copy()
    height, width = out.shape[:2]
    scale = np.array([width / meta.width, height / meta.height])
    colors = palette(len(meta.part_names))
    thick = max(1, round(min(height, width) / 240))
    bits = 4  # OpenCV's fixed-point coordinates: sub-pixel ends
    limit = 8 * max(height, width)  # a far-off end must not overflow an int
    labels: list[tuple[str, tuple[int, int], tuple[int, ...]]] = []

    def at(uv: tuple[float, float]) -> tuple[int, int]:
        x, y = np.clip((np.array(uv) + 0.5) * scale - 0.5, -limit, limit) * 2**bits
        return round(float(x)), round(float(y))

    for axis in joint_axes(meta, state, t):
        scored = meta.joint_names[axis.joint] in meta.scored_joints
        if scored_only and not scored:
            continue
        r, g, b = (int(c) for c in colors[int(state.joint_child_part[axis.joint])])
        wing = _arrow(axis)
        lines = ((axis.tail, axis.head), (wing[0], axis.head), (wing[1], axis.head))
        weight = (2 if scored else 1) * thick
        for color, extra in (((255, 255, 255), 2 * thick), ((r, g, b), 0)):  # a halo, then the line
            for a, z in lines:
                cv2.line(out, at(a), at(z), color, weight + extra, cv2.LINE_AA, bits)
            radius = round((2 * thick + extra / 2) * 2**bits)
            cv2.circle(out, at(axis.point), radius, color, -1, cv2.LINE_AA, bits)
        u, v = at(axis.head)
        labels.append((meta.joint_names[axis.joint], (u >> bits, v >> bits), (r, g, b)))
    writer = Labels(out)
    for label in labels:  # over all lines
        writer.write(*label)
    return out


def _arrow(axis: Axis) -> Array:
    """The two ends [2 2] px of an arrow head's wings."""
    head, back = np.array(axis.head), np.array(axis.tail) - np.array(axis.head)
    back = 0.12 * back
    side = 0.5 * np.array([-back[1], back[0]])
    return np.stack([head + back + side, head + back - side])


def has_points(state: State) -> bool:
    """Whether there is anything to draw."""
    return any(x is not None and x.shape[1] for x in (state.track_image, state.keypoint_image))


def draw_points(rgb: RgbImage, meta: Meta, state: State, t: int) -> RgbImage:
    """A copy of `rgb` [H W 3], paled, with the tracks and keypoints of frame t in their parts'
    colours: a track's trail leads back in time, what is hidden is a ring, visible keypoints have
    names.

    `rgb` may be smaller or larger than the sequence's own size.
    """
    import cv2

    out = np.ascontiguousarray(np.rint(0.5 * rgb + 0.5 * 235), np.uint8)
    height, width = out.shape[:2]
    scale = np.array([width / meta.width, height / meta.height])
    colors = palette(len(meta.part_names))
    thick = max(1, round(min(height, width) / 400))
    bits = 4  # OpenCV's fixed-point coordinates
    limit = 8 * max(height, width)

    def pixels(image: Array) -> NDArray[np.int32]:
        found = np.clip((image + 0.5) * scale - 0.5, -limit, limit)
        return np.rint(found * 2**bits).astype(np.int32)

    def dot(at: NDArray[np.int32], part: int, visible: bool, size: int) -> None:
        r, g, b = (int(c) for c in colors[part])
        place = (int(at[0]), int(at[1]))
        width = -1 if visible else thick
        cv2.circle(out, place, size << bits, (r, g, b), width, cv2.LINE_AA, bits)

    if state.track_image is not None and state.track_part is not None:
        assert state.track_visible is not None
        past = state.track_image[max(0, t - _TRAIL) : t + 1]
        for n in range(0, len(state.track_part), max(1, -(-len(state.track_part) // _MOST_TRACKS))):
            part = state.track_part[n]
            path = past[np.isfinite(past[:, n]).all(axis=-1), n]
            r, g, b = (int(c) for c in colors[part])
            cv2.polylines(out, [pixels(path)], False, (r, g, b), thick, cv2.LINE_AA, bits)
            if np.isfinite(past[-1, n]).all():
                dot(pixels(past[-1, n]), int(part), bool(state.track_visible[t, n]), 2 * thick)
    if state.keypoint_image is not None and state.keypoint_part is not None:
        labels = Labels(out)
        assert state.keypoint_visible is not None
        for k, part in enumerate(state.keypoint_part):
            at = state.keypoint_image[t, k]
            if np.isfinite(at).all():
                dot(pixels(at), int(part), bool(state.keypoint_visible[t, k]), 4 * thick)
                if state.keypoint_visible[t, k]:
                    u, v = pixels(at) >> bits
                    labels.write(meta.keypoint_names[k], (int(u), int(v)))
    return out
