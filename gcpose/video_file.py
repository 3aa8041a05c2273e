"""GC-Pose on a video file: which frames are read, and what is written of the estimate."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, printable
from ..renderer.types import Estimate, Observation
from ..robots.files import write_atomically
from ..robots.geometry import Array
from .images import ImageSettings, still_texture_share
from .method import GCPose

_FFMPEG = {
    "OPENCV_FFMPEG_CAPTURE_OPTIONS": "format_whitelist;mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi",
    "OPENCV_FFMPEG_LOGLEVEL": "-8",
}
"""Only containers that hold the video itself: a playlist could name other files and addresses. The
messages of FFmpeg are not shown."""
_MAX_SIDE, _MAX_FRAMES = 8192, 100_000  # of a video file
_LEAST_SIDE = 16  # of what is used
_BLACK = 12  # grey levels of a black bar at most
_MIDDLE_FOV = 50.0  # deg; where the search begins if none is given
Region = tuple[int, int, int, int]
"""Part of an image, px: the first pixel (u, v), width and height."""
_COLORS = np.array([[0, 0, 0], [255, 60, 40], [40, 160, 255], [60, 220, 60], [255, 200, 0],
                    [220, 80, 255]], np.uint8)
"""RGB of parts in a picture; the first is not used."""


@dataclass(frozen=True)
class VideoFrames:
    """Frames of a video file."""

    rgb: NDArray[np.uint8]
    """[T H W 3]"""
    number: NDArray[np.int64]
    """[T] of each frame in the file, from 0"""
    times: Array
    """[T] s since the beginning of the file"""
    size: tuple[int, int]
    """(width, height) of the images of the file, px"""
    region: Region
    """The part of them that `rgb` shows"""

    @property
    def scale(self) -> Array:
        """Pixels of `rgb` by pixel of the file [2], across and down."""
        return np.divide(self.rgb.shape[2:0:-1], self.region[2:])


def read_frames(
    path: Path, count: int, start: float = 0.0, end: float = np.inf,
    region: Region | None = None, side: int = 480,
) -> VideoFrames:
    """Return `count` evenly spaced frames between two times, s; all if there are fewer.

    Of the images, only a region (u, v, width, height), px, is used; by default, all but the black
    bars at their edges. Larger ones are reduced until their smaller side is `side` px.

    Raises:
        ConfigError: If the file is not a video, is damaged or too large, or has fewer than two such
            frames, or if the region is not in the images.
    """
    name = printable(str(path))
    if not 2 <= count <= 1000:
        raise ConfigError(f"--frames {count}: give 2 to 1000")
    if not 0 <= start < end:
        raise ConfigError(f"--start {start:g} --end {end:g}: give 0 or more, the smaller one first")
    if not path.is_file():
        raise ConfigError(f"{name}: no such file; give a video, such as door.mp4")
    fps, total = _count_frames(path, name)
    first = max(0, int(np.ceil(start * fps - 1e-6)))
    last = min(total - 1, int(np.floor(min(end, total / fps) * fps + 1e-6)))
    if last <= first:
        raise ConfigError(f"{name}: has {max(0, last - first + 1)} frames between {start:g} and "
                          f"{min(end, total / fps):g} s; two are needed, change --start or --end")
    number = np.unique(np.linspace(first, last, min(count, last - first + 1)).round().astype(int))
    images, video, wanted = list[NDArray[np.uint8]](), _open(path, name), set(number.tolist())
    whole: Region = (0, 0, 0, 0)
    for k in range(last + 1):
        found, image = video.read() if k in wanted else (video.grab(), None)
        if not found:
            raise ConfigError(f"{name}: frame {k} is damaged; change --start or --end")
        if image is not None:
            whole = (0, 0, image.shape[1], image.shape[0])
            _check_region(region or whole, whole[2:], name)
            images.append(_reduce(image, region or whole, side))
    frames = VideoFrames(np.stack(images), number, number / fps, whole[2:], region or whole)
    return frames if region else _without_bars(frames)


def check_outputs(video: Path, outputs: Iterable[Path]) -> None:
    """Refuse files to write that have no folder, or are the video.

    Raises:
        ConfigError: If there is one.
    """
    for path in outputs:
        if not path.absolute().parent.is_dir():
            raise ConfigError(f"{path}: its folder does not exist; make it")
        if path.resolve() == video.resolve():
            raise ConfigError(f"{path}: is the video; name another file")


def check_distance(distance: float | None, types: Sequence[str]) -> None:
    """Refuse a distance, m, that is out of range, missing, or not used by joints of these types.

    Raises:
        ConfigError: If it is.
    """
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


def find_field_of_view(
    method: GCPose, video: VideoFrames, axes: Sequence[float], types: Sequence[str]
) -> float:
    """Return the vertical field of view of a video of a door or a drawer, by its straight edges,
    deg.

    Raises:
        ConfigError: If they do not tell it, or if `axes` are of several joints.
    """
    focal = None
    if len(axes) <= 3:
        focal = method.find_focal_length(observe_video(video, _MIDDLE_FOV, types=types))
    if focal is None:
        raise ConfigError("no straight edges show the field of view; give --fov")
    return float(np.degrees(2 * np.arctan(video.size[1] * video.scale[1] / 2 / focal)))


def find_axes(method: GCPose, observation: Observation) -> Array | None:
    """Return the directions [J 3] of the axes: those that are known, or that which the straight
    edges of a door show; None for one that slides, whose estimate tells it.

    Raises:
        ConfigError: If they do not tell it.
    """
    if observation.axis_direction is not None:
        return observation.axis_direction
    if observation.joint_types == ("prismatic",):
        return None
    axis = method.find_axis(observation)
    if axis is None:
        raise ConfigError("no straight edges show where the axis points; give --axes")
    return axis[None]


def towards_camera(estimate: Estimate) -> tuple[Estimate, Array]:
    """Return the estimate of one slide with the sign that makes its axis point towards the camera,
    and that axis [1 3].

    Raises:
        ConfigError: If nothing was seen to move.
    """
    if estimate.screw is None:
        raise ConfigError("nothing is seen to slide; choose a part of the video in which it does "
                          "(--start, --end), or the part of the images where it is (--region)")
    sign = -1.0 if estimate.screw[0, 2] > 0 else 1.0
    screw = sign * estimate.screw
    return replace(estimate, displacement=sign * estimate.displacement, screw=screw), screw[:, :3]


def doubt_still_texture(
    video: VideoFrames, estimate: Estimate, settings: ImageSettings
) -> tuple[Estimate, float]:
    """Return an estimate that is not reliable if much of the texture of its parts stays where it
    is, and that share."""
    assert estimate.part is not None and estimate.reliable is not None
    share = still_texture_share(video.rgb, estimate.part > 0, settings)
    reliable = estimate.reliable & (share <= settings.max_still_texture)
    return replace(estimate, reliable=reliable), share


def write_table(
    path: Path, video: VideoFrames, estimate: Estimate, types: Sequence[str]
) -> None:
    """Write CSV: one line for each frame and joint, deg or m."""
    assert estimate.sigma is not None
    lines = ["frame,time,joint,displacement,deviation,unit"]
    for t, (moved, sigma) in enumerate(zip(estimate.displacement, estimate.sigma, strict=True)):
        for j, (unit, factor, digits) in enumerate(map(_unit_of, types)):
            lines.append(f"{video.number[t]},{video.times[t]:.6g},{j + 1},"
                         f"{factor * moved[j]:.{digits}f},{factor * sigma[j]:.{digits}f},{unit}")
    write_atomically(path, "".join(f"{line}\n" for line in lines).encode())


def summarize_estimate(
    estimate: Estimate, axes: Array, types: Sequence[str]
) -> list[dict[str, Any]]:
    """Return what is estimated of each joint at the last frame, deg or m, and its axis [J 3]."""
    assert estimate.sigma is not None and estimate.reliable is not None
    last = zip(estimate.displacement[-1], estimate.sigma[-1], estimate.reliable, axes, types,
               strict=True)
    out = list[dict[str, Any]]()
    for j, (moved, sigma, reliable, axis, type_) in enumerate(last, 1):
        unit, factor, _ = _unit_of(type_)
        out.append({"joint": f"joint {j}", "displacement": float(factor * moved),
                    "deviation": float(factor * sigma), "unit": unit, "reliable": bool(reliable),
                    "axis": [round(float(x), 4) for x in axis]})
    return out


def describe_joints(joints: list[dict[str, Any]]) -> list[str]:
    """Return a line of text for each joint of `summarize_estimate`."""
    out = list[str]()
    for j in joints:
        digits, unit = 4 if j["unit"] == "m" else 2, j["unit"]
        out.append(f"{j['joint']}: {j['displacement']:.{digits}f} {unit}, standard deviation "
                   f"{j['deviation']:.{digits}f} {unit}" + ", not reliable" * (not j["reliable"]))
    return out


def _unit_of(joint_type: str) -> tuple[str, float, int]:
    """The unit of a displacement in a table, its size by rad or m, and the digits shown."""
    return ("m", 1.0, 6) if joint_type == "prismatic" else ("deg", 180 / np.pi, 4)


def draw_parts(path: Path, video: VideoFrames, estimate: Estimate, most: int = 6) -> None:
    """Write a PNG of at most so many frames, in two rows, with the estimated parts in color."""
    assert estimate.part is not None
    shown = list[NDArray[np.uint8]]()
    for t in np.unique(np.linspace(0, len(video.rgb) - 1, most).astype(int)):
        part = estimate.part[t]
        color = _COLORS[np.where(part > 0, (part - 1) % (len(_COLORS) - 1) + 1, 0)]
        mixed = np.where(part[..., None] > 0, video.rgb[t] // 2 + color // 2, video.rgb[t])
        shown.append(np.asarray(cv2.resize(mixed, None, fx=0.5, fy=0.5,
                                           interpolation=cv2.INTER_AREA), np.uint8))
    half = -(-len(shown) // 2)
    shown += [np.zeros_like(shown[0])] * (2 * half - len(shown))
    rows = np.vstack([np.hstack(shown[:half]), np.hstack(shown[half:])])
    write_atomically(path, cv2.imencode(".png", rows[..., ::-1])[1].tobytes())


def _open(path: Path, name: str) -> cv2.VideoCapture:
    os.environ.update(_FFMPEG)
    log = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    log.setLogLevel(level)
    if not video.isOpened():
        raise ConfigError(f"{name}: is not a video that can be read; convert it to MP4")
    sides = [video.get(p) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
    if not _LEAST_SIDE <= min(sides) <= max(sides) <= _MAX_SIDE:
        raise ConfigError(f"{name}: images of {sides[0]:g} x {sides[1]:g} px; give a video of "
                          f"{_LEAST_SIDE} to {_MAX_SIDE} px")
    return video


def _reduce(image: NDArray[Any], region: Region, side: int) -> NDArray[np.uint8]:
    """Return RGB of a region of an image, with a smaller side of at most `side` px."""
    u, v, width, height = region
    factor = max(1.0, min(width, height) / side)
    size = round(width / factor), round(height / factor)
    used = image[v : v + height, u : u + width, ::-1]
    return np.asarray(cv2.resize(used, size, interpolation=cv2.INTER_AREA), np.uint8)


def _without_bars(frames: VideoFrames) -> VideoFrames:
    """Return frames without the black bars at their edges."""
    light = frames.rgb.max(axis=(0, 3)) > _BLACK
    rows, columns = (np.flatnonzero(light.any(axis=k)) for k in (1, 0))
    if not len(rows) or min(np.ptp(rows), np.ptp(columns)) < _LEAST_SIDE:
        return frames
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    low, high = (np.rint(np.array(p) / frames.scale).astype(int)
                 for p in ((left, top), (right, bottom)))
    region = (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
    return replace(frames, rgb=frames.rgb[:, top:bottom, left:right], region=region)


def _check_region(region: Region, size: tuple[int, int], name: str) -> None:
    """Refuse a region that is not in images of a size (width, height), px."""
    u, v, width, height = region
    if (min(u, v) < 0 or min(width, height) < _LEAST_SIDE or u + width > size[0]
            or v + height > size[1]):
        raise ConfigError(f"--region {u} {v} {width} {height}: give U V WIDTH HEIGHT inside of "
                          f"the images of {name}, {size[0]} x {size[1]} px")


def _count_frames(path: Path, name: str) -> tuple[float, int]:
    """Return the frames per second of a video, and how many can be read."""
    video, total = _open(path, name), 0
    while total <= _MAX_FRAMES and video.grab():
        total += 1
    if total > _MAX_FRAMES:
        raise ConfigError(f"{name}: has more than {_MAX_FRAMES} frames; cut it")
    fps = video.get(cv2.CAP_PROP_FPS)
    return (fps if np.isfinite(fps) and 0 < fps < 1e4 else 30.0), total
