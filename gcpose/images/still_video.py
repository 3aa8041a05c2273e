"""A video as a camera would take it that stands still and keeps its exposure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...renderer.types import Estimate, Observation
from .camera_motion import CameraMotion, align_frames, find_camera_motion, move_labels_back
from .camera_noise import remove_misalignment
from .exposure import equalize_exposure
from .settings import ImageSettings


@dataclass(frozen=True)
class StillVideo:
    """What a still camera of constant exposure would see."""

    observation: Observation
    motion: CameraMotion | None
    """Of the camera, which is taken out of the images"""
    settings: ImageSettings

    def move_back(self, estimate: Estimate) -> Estimate:
        """Return an estimate whose parts are at the pixels before alignment. No joint of it is
        reliable if the background is not aligned well."""
        if self.motion is None:
            return estimate
        part, reliable = estimate.part, estimate.reliable
        if part is not None:
            part = move_labels_back(part, self.motion)
        if reliable is not None and self.motion.error > self.settings.sure_background_error:
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
        return StillVideo(observation, None, settings)
    motion = find_camera_motion(rgb, settings) if all(t is None for t in truth) else None
    if motion is None:
        return StillVideo(replace(observation, rgb=equalize_exposure(rgb, settings)), None,
                          settings)
    aligned, shown = align_frames(rgb, motion, settings)
    even = equalize_exposure(aligned, settings)
    still = remove_misalignment(even, np.asarray(shown), motion.error, settings)
    return StillVideo(replace(observation, rgb=still), motion, settings)
