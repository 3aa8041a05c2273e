"""Plain data that decides every pixel of a sequence."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ...robots.model import ArticulatedModel, Material
from ...robots.motion import JointTrajectory
from ..types import Camera
from .room import RoomSurface


@dataclass(frozen=True)
class Light:
    """Light from infinity."""

    direction: Array
    """[3] unit, world frame, the way the light travels."""
    color: tuple[float, float, float]
    """Linear RGB, 0..1"""
    intensity: float
    """Radiance factor."""


@dataclass(frozen=True)
class Scene:
    """One sequence before it is drawn. Nothing random is left in it."""

    model: ArticulatedModel
    trajectory: JointTrajectory
    cameras: tuple[Camera, ...]
    """of each frame; one and the same object if the camera stands still"""
    lights: tuple[Light, ...]
    ambient: float
    shadows: bool
    materials: tuple[Material, ...]
    """One per visual of the model."""
    texture_size: Array
    """[len(visuals)] m: side of a texture's tile where UVs come from box projection; 0 keeps the
    mesh's own UVs."""
    backdrop: NDArray[np.uint8] | None
    """[H W 3] picture behind everything (no surface), or None if there is a room."""
    room: tuple[RoomSurface, ...]
    noise: float
    """Standard deviation, grey levels."""
    noise_seed: int
    blur: float
    """px"""
    exposure: Array
    """[T] stops"""

    def backdrop_seen_by(self, camera: Camera) -> NDArray[np.uint8] | None:
        """Return the backdrop [H W 3] as a camera of the scene shows it: it is infinitely far."""
        first = self.cameras[0]
        if self.backdrop is None or camera is first:
            return self.backdrop
        turn = camera.cam_from_world[:3, :3] @ first.world_from_cam[:3, :3]
        to = camera.intrinsics @ turn @ np.linalg.inv(first.intrinsics)
        return np.asarray(cv2.warpPerspective(
            self.backdrop, to, (camera.width, camera.height), borderMode=cv2.BORDER_REFLECT),
            np.uint8)
