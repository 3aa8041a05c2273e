"""Whether the estimate of a video can be believed, and why not."""

from __future__ import annotations

from dataclasses import replace

from ...errors import ConfigError
from ...renderer.types import Estimate, Observation
from ..images import ImageSettings, find_camera_motion, still_texture_share
from ..method import GCPose
from .frames import VideoFrames
from .observation import NOTHING_MOVES


def check_motion(estimate: Estimate) -> None:
    """Refuse the estimate of a video in which nothing is seen to move.

    Raises:
        ConfigError: If nothing is.
    """
    if estimate.part is None or not estimate.part.any():
        raise ConfigError(NOTHING_MOVES)


def doubt_still_texture(
    video: VideoFrames, estimate: Estimate, settings: ImageSettings
) -> tuple[Estimate, float]:
    """Return an estimate that is not reliable if much of the texture of its parts stays where it
    is, and that share."""
    assert estimate.part is not None and estimate.reliable is not None
    share = still_texture_share(video.rgb, estimate.part > 0, settings)
    reliable = estimate.reliable & (share <= settings.max_still_texture)
    return replace(estimate, reliable=reliable), share


def explain_doubts(
    method: GCPose, observation: Observation, estimate: Estimate, still_share: float
) -> list[str | None]:
    """Return why each joint is not reliable; None for one that is.

    `still_share` is that of `doubt_still_texture`.
    """
    assert estimate.reliable is not None and observation.rgb is not None
    if estimate.reliable.all():
        return [None] * observation.n_joints
    settings = method.settings.images
    motion = find_camera_motion(observation.rgb, observation.intrinsics, settings)
    if motion is not None and not motion.is_sure(settings):
        reason = "the camera moves, and its motion is not known well; put it on a stand"
    elif still_share > settings.max_still_texture:
        reason = (f"{still_share:.0%} of the texture of what seems to move stays where it is, as "
                  "in a shadow; leave it out by --region")
    elif method.finds_shadows(observation):
        reason = ("texture that stays where it is, as in a shadow, was left out of what seems to "
                  "move; leave the shadow out by --region")
    else:
        reason = "its standard deviation is large"
    return [None if good else reason for good in estimate.reliable]
