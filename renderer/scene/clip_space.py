"""Transformations from camera, world and light frames to OpenGL's clip space.

OpenGL's pixel centers are at j + 0.5, those of this package at j: `clip_from_cam` converts them.
It also draws images upside down, so that row 0 of the buffer is the top row; this reverses the
winding of triangles.
"""

from __future__ import annotations

import numpy as np

from ...robots.geometry import Array, apply
from ..types import Camera
from .scene import Light


def clip_from_cam(camera: Camera, near: float, far: float) -> Array:
    """Return clip_from_cam [4 4]; image row 0 is at the bottom of OpenGL's window."""
    w, h, k = camera.width, camera.height, camera.intrinsics
    clip = np.zeros((4, 4))
    clip[0] = 2.0 / w * np.append(k[0], 0.0)  # u_gl = u + 0.5, from 0 at the left edge
    clip[0, 2] += 1.0 / w - 1.0
    clip[1] = 2.0 / h * np.append(k[1], 0.0)
    clip[1, 2] += 1.0 / h - 1.0
    clip[2, 2] = (far + near) / (far - near)
    clip[2, 3] = -2.0 * far * near / (far - near)
    clip[3, 2] = 1.0
    return clip


def box_corners(points: Array) -> Array:
    """Return the corners [8 3] of the bounding box of points [N 3]."""
    low, high = points.min(0), points.max(0)
    return np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)


def clip_from_world(camera: Camera, points: Array) -> Array:
    """Return clip_from_world [4 4] whose near and far planes enclose world points [N 3]."""
    z = apply(camera.cam_from_world, points)[:, 2] if len(points) else np.ones(1)
    far = max(float(z.max()) * 1.01, 1e-3)
    # Some room walls are behind the camera: the near plane is then at 0.001 of the far one.
    near = max(float(z.min()) * 0.9, far * 1e-3)
    return clip_from_cam(camera, near, far) @ camera.cam_from_world


def clip_from_light(light: Light, points: Array) -> Array:
    """Return the orthographic clip space [4 4] of a light that tightly encloses points [N 3]."""
    z = light.direction / np.linalg.norm(light.direction)
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.99 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z])
    local = points @ axes.T
    low, high = local.min(0) - 1e-3, local.max(0) + 1e-3
    clip = np.eye(4)
    clip[:3, :3] = axes * (2.0 / (high - low))[:, None]
    clip[:3, 3] = -(high + low) / (high - low)
    return clip
