"""Frames of a video file."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, printable
from ...robots.geometry import Array

_FFMPEG = {
    "OPENCV_FFMPEG_CAPTURE_OPTIONS": "format_whitelist;mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi",
    "OPENCV_FFMPEG_LOGLEVEL": "-8",
}
"""Only containers that hold the video itself: a playlist could name other files and addresses. The
messages of FFmpeg are not shown."""
_MAX_SIDE, _MAX_FRAMES = 8192, 100_000  # of a video file
_LEAST_SIDE = 16  # of what is used
_BLACK = 12  # grey levels of a black bar at most
Region = tuple[int, int, int, int]
"""Part of an image, px: the first pixel (u, v), width and height."""


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
