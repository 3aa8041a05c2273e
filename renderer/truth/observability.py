"""Whether the motion of a sequence can be seen: the benchmark protocol's rule, from the truth.

A sequence is observable if every scored joint moves far enough, shows enough pixels of what it
moves, unoccluded enough, and moves them by enough pixels, in images of 640 x 480 (other sizes:
counts scale with the area, motion with the smaller ratio of sides); and if nothing touches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, apply, pinhole, prismatic_motion, revolute_motion
from ...robots.model import ArticulatedModel
from ..types import Camera

MIN_ANGLE, MIN_DISTANCE = np.radians(10.0), 0.03
MIN_PIXELS, MIN_SHARE = 400, 0.25
MIN_MOTION = 0.3


@dataclass(frozen=True)
class JointVisibility:
    """What the images show of a scored joint."""

    displacement: float
    """Over the whole sequence, rad or m."""
    pixels: int
    """Fewest visible pixels of its moving subtree in a frame."""
    share: float
    """Smallest share of the subtree's pixels that nothing else hides, in a frame."""
    motion: float
    """Its own contribution to image motion: median over its subtree, mean over steps, px."""

    def reason(self, prismatic: bool, width: int, height: int) -> str:
        """The first rule that is broken: "displacement", "hidden", "occluded", "still" or ""."""
        if abs(self.displacement) < (MIN_DISTANCE if prismatic else MIN_ANGLE) * (1 - 1e-9):
            return "displacement"
        if self.pixels < MIN_PIXELS * (width * height) / (640 * 480):
            return "hidden"
        if self.share < MIN_SHARE:
            return "occluded"
        if self.motion < MIN_MOTION * min(width / 640, height / 480):
            return "still"
        return ""


def subtrees(model: ArticulatedModel, joints: NDArray[np.int64]) -> NDArray[np.bool_]:
    """[joints P] the parts that each of the given joints moves (mimicking parts included)."""
    out = np.zeros((len(joints), len(model.parent)), bool)
    for k, joint in enumerate(joints):
        for part in np.flatnonzero(model.joint == joint):
            out[k] |= model.subtree(int(part))
    return out


def own_motion(
    camera: Camera, depth: NDArray[np.float32], index: NDArray[np.int64], screw: Array,
    prismatic: bool, step: float,
) -> float:
    """Return the median length, px, of the flow that one joint's step (rad or m) alone causes.

    `index` [N] are the flat indices of the pixels that show what the joint moves, at `depth` [H W]
    m; its `screw` [6] is in the camera frame.
    """
    if not index.size:
        return 0.0
    index = index[:: max(1, len(index) // 2000)]  # 2000 suffice for the median
    v, u = np.divmod(index, camera.width)
    uv = np.stack([u, v], axis=1)
    # By the inverse matrix, not by `pinhole.unproject`: meta.json keeps its last digit.
    rays = np.stack([u, v, np.ones_like(u)], axis=1) @ np.linalg.inv(camera.intrinsics).T
    points = rays * depth.ravel()[index, None]
    motion = (prismatic_motion if prismatic else revolute_motion)(screw, step)
    there = pinhole.project(camera.intrinsics, apply(motion, points))
    return float(np.median(np.linalg.norm(there[:, :2] - uv, axis=1)))
