"""Keypoints and tracks drawn over a photograph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..types import Meta, State
from .colors import Image, palette, write

TRAIL = 8
"""Frames of a track's past that its trail shows."""
MOST = 100
"""Tracks that one can tell apart in a picture; of more, evenly spread ones are drawn."""


def has_points(state: State) -> bool:
    """Whether there is anything to draw."""
    return any(x is not None and x.shape[1] for x in (state.track_image, state.keypoint_image))


def points_image(rgb: Image, meta: Meta, state: State, t: int) -> Image:
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
        past = state.track_image[max(0, t - TRAIL) : t + 1]
        for n in range(0, len(state.track_part), max(1, -(-len(state.track_part) // MOST))):
            part = state.track_part[n]
            path = past[np.isfinite(past[:, n]).all(axis=-1), n]
            r, g, b = (int(c) for c in colors[part])
            cv2.polylines(out, [pixels(path)], False, (r, g, b), thick, cv2.LINE_AA, bits)
            if np.isfinite(past[-1, n]).all():
                dot(pixels(past[-1, n]), int(part), bool(state.track_visible[t, n]), 2 * thick)
    if state.keypoint_image is not None and state.keypoint_part is not None:
        assert state.keypoint_visible is not None
        for k, part in enumerate(state.keypoint_part):
            at = state.keypoint_image[t, k]
            if np.isfinite(at).all():
                dot(pixels(at), int(part), bool(state.keypoint_visible[t, k]), 4 * thick)
                if state.keypoint_visible[t, k]:
                    u, v = pixels(at) >> bits
                    write(out, meta.keypoint_names[k], (int(u) + 4, int(v)))
    return out
