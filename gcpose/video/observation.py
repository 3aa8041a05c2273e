"""What GC-Pose sees in a video file: its images, the camera, and the axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import ConfigError
from ...renderer.types import Observation
from ...robots.geometry import Array
from ..method import GCPose
from .frames import VideoFrames

NOTHING_MOVES = (
    "nothing is seen to move; choose a part of the video in which it does (--start, --end), or the "
    "part of the images where it is (--region)")
_MIDDLE_FOV = 50.0  # deg; where the search begins if none is given


def check_joints(
    axes: Sequence[float], types: Sequence[str], fov: float | None, distance: float | None
) -> None:
    """Refuse several joints without axes or without a field of view, and a distance, m, that is out
    of range, missing, or not used by joints of these types.

    Raises:
        ConfigError: If there is one.
    """
    if len(types) > 1 and not axes:
        raise ConfigError(f"--types names {len(types)} joints; give three numbers of --axes for "
                          "each joint")
    if len(axes) >= 6 and fov is None:
        raise ConfigError("several joints need --fov")
    slides = "prismatic" in types
    if slides and distance is None:
        raise ConfigError("a joint that slides needs --distance: how far what moves is from the "
                          "camera at the first frame, m")
    if distance is not None and not slides:
        raise ConfigError("--distance is for joints that slide; give --types prismatic, or leave "
                          "it out")
    if distance is not None and not 0.01 <= distance <= 1000:
        raise ConfigError(f"--distance {distance:g}: give 0.01 to 1000 m")


def observe_video(
    video: VideoFrames, fov: float, axes: Sequence[float] = (), types: Sequence[str] = (),
    base: tuple[float, float] | None = None,
) -> Observation:
    """Return what GC-Pose sees of joints, each carried by the one before.

    `fov` is the vertical field of view, deg; `axes` are three numbers for each joint (camera frame,
    x right, y down, z forward), or none for one joint whose axis is not known; `types` are those of
    the joints, or none if all turn; `base` is the pixel (u, v) of the file where the first part
    stands.

    Raises:
        ConfigError: If a value is out of range.
    """
    height, width = video.rgb.shape[1:3]
    if not 1 <= fov <= 170:
        raise ConfigError(f"--fov {fov:g}: give the vertical field of view, 1 to 170 deg")
    direction = np.array(axes, np.float64)
    if len(direction) % 3:
        raise ConfigError(f"--axes has {len(direction)} numbers; give three for each joint")
    direction = direction.reshape(-1, 3)
    joints = max(1, len(direction))
    types = tuple(types) or ("revolute",) * joints
    if len(types) != joints:
        raise ConfigError(f"--types names {len(types)} joints; --axes has {len(direction)}")
    length = np.linalg.norm(direction, axis=1)
    if not (np.isfinite(length) & (length > 0)).all():
        raise ConfigError("--axes: each joint needs a direction that is finite and not 0 0 0")
    focal = video.size[1] * video.scale[1] / 2 / np.tan(np.radians(fov) / 2)
    center = (np.array(video.size) / 2 - video.region[:2]) * video.scale - 0.5
    k = np.array([[focal, 0, center[0]], [0, focal, center[1]], [0, 0, 1]])
    world = None
    if base is not None:
        u, v = np.subtract(base, video.region[:2]) * video.scale
        if not (0 <= u < width and 0 <= v < height):
            raise ConfigError(f"--base {base[0]:g} {base[1]:g} is outside of the image, or of "
                              "the --region")
        world = np.eye(4)
        world[:3, 3] = np.linalg.solve(k, [u, v, 1])
    return Observation(
        video.rgb, None, k, video.times, joints, types, cam_from_world=world,
        axis_direction=direction / length[:, None] if len(direction) else None)


def find_field_of_view(method: GCPose, video: VideoFrames, types: Sequence[str]) -> float:
    """Return the vertical field of view of a video of a door or a drawer, by its straight edges,
    deg.

    Raises:
        ConfigError: If they do not tell it, or if nothing moves.
    """
    observation = observe_video(video, _MIDDLE_FOV, types=types)
    focal = method.find_focal_length(observation)
    if focal is None:
        if not method.sees_motion(observation):
            raise ConfigError(NOTHING_MOVES)
        raise ConfigError("no straight edges show the field of view; give --fov")
    return float(np.degrees(2 * np.arctan(video.size[1] * video.scale[1] / 2 / focal)))


def find_axes(method: GCPose, observation: Observation, *, fov_found: bool) -> Array | None:
    """Return the directions [J 3] of the axes: those that are known, or that which the straight
    edges of a door show; None for one that slides, whose estimate tells it.

    `fov_found`: the edges have shown the field of view, too.

    Raises:
        ConfigError: If they do not tell it, or if nothing moves.
    """
    if observation.axis_direction is not None:
        return observation.axis_direction
    if observation.joint_types == ("prismatic",):
        return None
    axis = method.find_axis(observation)
    if axis is None:
        if not method.sees_motion(observation):
            raise ConfigError(NOTHING_MOVES)
        raise ConfigError("no straight edges show where the axis points; give --axes" + (
            "" if fov_found else
            ", or another --fov (without --fov, the edges may show it)"))
    return axis[None]
