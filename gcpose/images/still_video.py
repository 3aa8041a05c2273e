"""A video as a camera would take it that stands still and keeps its exposure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Estimate, Observation
from ...robots.geometry import Array
from .camera_motion import find_camera_motion
from .exposure import apply_tones, equalize_exposure, find_tones
from .settings import ImageSettings
from .still_scene import show_still_scene


@dataclass(frozen=True)
class StillVideo:
    """What a still camera of constant exposure would see."""

    observation: Observation
    homography: Array | None = None
    """[T 3 3] from its pixels to those of the images as they are, if the camera moves"""
    sure: bool = True
    """Whether the motion of the camera is known well"""

    def move_back(self, estimate: Estimate) -> Estimate:
        """Return an estimate whose parts are at the pixels of the images as they are. No joint of
        it is reliable if the motion of the camera is not known well."""
        if self.homography is None:
            return estimate
        part, reliable = estimate.part, estimate.reliable
        if part is not None:
            size = part.shape[2], part.shape[1]
            part = np.stack([
                np.asarray(cv2.warpPerspective(p, h, size, flags=cv2.INTER_NEAREST), np.uint8)
                for p, h in zip(part, self.homography, strict=True)])
        if reliable is not None and not self.sure:
            reliable = np.zeros_like(reliable)
        return replace(estimate, part=part, reliable=reliable)


def to_still_video(observation: Observation, settings: ImageSettings) -> StillVideo:
    """Return an observation with images of a still camera and of one exposure.

    The motion of a camera on plain video is taken out, unless truth comes with the images: their
    flow, mask or parts would not fit.

    Raises:
        MethodError: If the camera moves too much.
    """
    rgb, truth = observation.rgb, (observation.depth, observation.flow, observation.mask,
                                   observation.part)
    if rgb is None:
        return StillVideo(observation)
    motion = None
    if all(t is None for t in truth):
        motion = find_camera_motion(rgb, observation.intrinsics, settings)
    if motion is None:
        return StillVideo(replace(observation, rgb=equalize_exposure(rgb, settings)))
    inverse_depth = float(np.median(motion.inverse_depth))
    tones = find_tones(_align_frames(rgb, motion.homography(inverse_depth)), settings)
    even = rgb if tones is None else apply_tones(rgb, tones)
    still, homography = show_still_scene(even, motion, settings)
    return StillVideo(replace(observation, rgb=still), homography, motion.is_sure(settings))


def _align_frames(rgb: NDArray[np.uint8], homography: Array) -> NDArray[np.uint8]:
    """Return images [T H W 3] seen through homographies; what they do not show is as in frame 0."""
    out = rgb.copy()
    size = rgb.shape[2], rgb.shape[1]
    for image, h in zip(out[1:], homography[1:], strict=True):
        cv2.warpPerspective(image.copy(), h, size, dst=image, borderMode=cv2.BORDER_TRANSPARENT,
                            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return out
