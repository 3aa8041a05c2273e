"""A pinhole camera: OpenCV axes (x right, y down, z forward), pixel centers at integers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...robots.geometry import Array, apply, inverse, pinhole, transform


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera without distortion: image size, intrinsics and pose."""

    width: int
    height: int
    intrinsics: Array
    """[3 3] px; the center of the top-left pixel is (0, 0)."""
    world_from_cam: Array
    """[4 4]"""

    @property
    def cam_from_world(self) -> Array:
        """[4 4]"""
        return inverse(self.world_from_cam)

    def project(self, points_in_world: ArrayLike) -> Array:
        """Return (u, v, z) [... N 3]: pixel and depth (m) of world points [... N 3]."""
        return pinhole.project(self.intrinsics, apply(self.cam_from_world, points_in_world))


def intrinsics_from_fov(width: int, height: int, vertical_fov: float) -> Array:
    """[3 3] px of a camera with square pixels; `vertical_fov` in rad over the image's height."""
    f = height / (2.0 * np.tan(vertical_fov / 2.0))
    return np.array([[f, 0.0, (width - 1) / 2.0], [0.0, f, (height - 1) / 2.0], [0.0, 0.0, 1.0]])


def look_at(eye: ArrayLike, target: ArrayLike, roll: float = 0.0) -> Array:
    """world_from_cam [4 4] of a camera at `eye` [3] looking at `target` [3], world z upward.

    `roll` (rad) turns the camera about its optical axis.
    """
    e, t = np.asarray(eye, np.float64), np.asarray(target, np.float64)
    z = (t - e) / np.linalg.norm(t - e)
    up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(roll), np.sin(roll)
    return transform(np.stack([c * x + s * y, c * y - s * x, z], axis=1), e)
