"""Frames of a video file."""

from __future__ import annotations

import os
import re
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
_TIME_ROUNDING = 2e-3  # s; containers round times, to 1 ms each
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
    """[T] s since the first frame of the file, by the file's own times"""
    size: tuple[int, int]
    """(width, height) of the images of the file, px, which are made square"""
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
    bars at their edges. Larger ones are reduced until their smaller side is `side` px. Pixels that
    are not square are made so first.

    Raises:
        ConfigError: If the file is not a video, is damaged or too large, or has fewer than two such
            frames, or if the region is not in the images.
    """
    name = printable(str(path))
    if not 2 <= count <= 1000:
        raise ConfigError(f"--frames {count}: give 2 to 1000")
    if not 0 <= start < end:
        raise ConfigError(f"--start {start:g} --end {end:g}: give 0 or more, the smaller one first")
    _check_path(path, name)
    times, fps = _read_times(path, name)
    first = int(np.searchsorted(times, start - 1e-6 / fps))
    last = int(np.searchsorted(times, end + 1e-6 / fps, "right")) - 1
    if last <= first:
        raise ConfigError(f"{name}: has {max(0, last - first + 1)} frames between {start:g} and "
                          f"{min(end, times[-1] + 1 / fps):g} s; two are needed, change --start or "
                          "--end")
    number = np.unique(np.linspace(first, last, min(count, last - first + 1)).round().astype(int))
    images, video, wanted = list[NDArray[np.uint8]](), _open(path, name), set(number.tolist())
    whole: Region = (0, 0, 0, 0)
    aspect = _pixel_aspect(video)
    for k in range(last + 1):
        found, image = video.read() if k in wanted else (video.grab(), None)
        if not found:
            raise ConfigError(f"{name}: frame {k} is damaged; change --start or --end")
        if image is not None:
            if aspect != 1:
                image = cv2.resize(image, None, fx=aspect, fy=1)
            whole = (0, 0, image.shape[1], image.shape[0])
            _check_region(region or whole, whole[2:], name)
            images.append(_reduce(image, region or whole, side))
    frames = VideoFrames(np.stack(images), number, times[number], whole[2:], region or whole)
    return frames if region else _without_bars(frames)


def _open(path: Path, name: str) -> cv2.VideoCapture:
    os.environ.update(_FFMPEG)
    log = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    log.setLogLevel(level)
    if not video.isOpened():
        raise ConfigError(f"{name}: is not a video that can be read, or is damaged; convert it to "
                          "MP4")
    sides = [video.get(p) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
    sides[0] = round(sides[0] * _pixel_aspect(video))
    if not _LEAST_SIDE <= min(sides) <= max(sides) <= _MAX_SIDE:
        raise ConfigError(f"{name}: images of {sides[0]:g} x {sides[1]:g} px; give a video of "
                          f"{_LEAST_SIDE} to {_MAX_SIDE} px")
    return video


def _pixel_aspect(video: cv2.VideoCapture) -> float:
    """Return the width of the pixels of a video by their height; 1 if the file does not tell it."""
    width, height = (video.get(p) for p in (cv2.CAP_PROP_SAR_NUM, cv2.CAP_PROP_SAR_DEN))
    if min(width, height) <= 0:
        return 1.0
    turned = video.get(cv2.CAP_PROP_ORIENTATION_META) % 180 == 90  # the images are, this is not
    return height / width if turned else width / height


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


def _check_path(path: Path, name: str) -> None:
    if re.match(r"\w+:/", str(path)):
        raise ConfigError(f"{name}: is an address; download the video first")
    if path.is_dir():
        raise ConfigError(f"{name}: is a folder; make a video of its images, e.g. by "
                          "ffmpeg -i %03d.png video.mp4")
    if not path.is_file():
        raise ConfigError(f"{name}: no such file; give a video, such as door.mp4")


def _read_times(path: Path, name: str) -> tuple[Array, float]:
    """Return the time [N] of each frame of a video that can be read, s since the first one, and
    the mean frames per second."""
    video, times = _open(path, name), list[float]()
    while len(times) <= _MAX_FRAMES and video.grab():
        times.append(video.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    if len(times) > _MAX_FRAMES:
        raise ConfigError(f"{name}: has more than {_MAX_FRAMES} frames; cut it")
    if len(times) < 2:
        raise ConfigError(f"{name}: " + (
            "the video has one frame; two are needed" if times else
            "no frame can be read; the file is damaged"))
    fps = video.get(cv2.CAP_PROP_FPS)
    fps = fps if np.isfinite(fps) and 0 < fps < 1e4 else 30.0
    own, even = np.array(times) - times[0], np.arange(len(times)) / fps
    varies = (np.diff(own) > 0).all() and np.abs(own - even).max() > _TIME_ROUNDING
    return (own if varies else even), fps
