"""What the network of the foreground sees: a square of the video with its colors and changes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numerics import Image
from .settings import ImageSettings

FOREGROUND_SIDE = 192
"""Side of the square as the network sees it, px."""
FOREGROUND_CHANNELS = 10
"""Channels of `color_and_change`."""
_MIN_SIDE = 48  # px
_SAME = 2  # grey levels: noise of one color
_LEVEL = np.log1p(np.arange(256, dtype=np.float32)) / np.float32(np.log(256))
"""Changes of 0..255 grey levels on a logarithmic scale of 0..1"""


@dataclass(frozen=True)
class Square:
    """A square of an image, which may reach beyond its edges."""

    left: int
    top: int
    side: int


def changing_pixels(rgb: NDArray[np.uint8], settings: ImageSettings) -> NDArray[np.bool_]:
    """Return which pixels [H W] of images [T H W 3] change."""
    return (rgb.max(axis=0) - rgb.min(axis=0)).max(axis=-1) > settings.change_threshold


def changing_square(rgb: NDArray[np.uint8], settings: ImageSettings) -> Square | None:
    """Return the square around what changes in images [T H W 3]; None if nothing does."""
    live = cv2.medianBlur(changing_pixels(rgb, settings).astype(np.uint8), 5)
    rows, columns = np.nonzero(live)
    if not len(rows):
        return None
    side = max(int(np.ptp(rows)), int(np.ptp(columns))) + 1
    side = max(_MIN_SIDE, round(side * (1 + 2 * settings.foreground_margin)))
    middle = (int(columns.min() + columns.max()) // 2, int(rows.min() + rows.max()) // 2)
    return Square(middle[0] - side // 2, middle[1] - side // 2, side)


def cut_square(images: NDArray[np.uint8], square: Square) -> NDArray[np.uint8]:
    """Return the square of images [T H W C], at the network's size; edges are repeated outside."""
    height, width = images.shape[1:3]
    rows, columns = (
        np.clip(np.arange(start, start + square.side), 0, size - 1)
        for start, size in ((square.top, height), (square.left, width)))
    smooth = cv2.INTER_AREA if square.side > FOREGROUND_SIDE else cv2.INTER_LINEAR
    size = (FOREGROUND_SIDE, FOREGROUND_SIDE)
    return np.stack([
        np.asarray(cv2.resize(image[rows][:, columns], size, interpolation=smooth), np.uint8)
        for image in images])


def paste_square(values: Image, square: Square, height: int, width: int) -> Image:
    """Return values [S S] in an image of a size; the least of them outside of the square."""
    size = (square.side, square.side)
    large = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_LINEAR), np.float32)
    out = np.full((height, width), values.min(), np.float32)
    top, left = max(0, square.top), max(0, square.left)
    bottom, right = min(height, square.top + square.side), min(width, square.left + square.side)
    out[top:bottom, left:right] = large[top - square.top : bottom - square.top,
                                        left - square.left : right - square.left]
    return out


def usual_color(rgb: NDArray[np.uint8], settings: ImageSettings) -> NDArray[np.uint8]:
    """Return the color [3 H W] that each pixel of images [T 3 H W] shows in most frames.

    In a long video, it is the most frequent one of `foreground_frames` frames.
    """
    count = min(len(rgb), settings.foreground_frames)
    return most_frequent(rgb[np.linspace(0, len(rgb) - 1, count).astype(int)],
                         settings.same_threshold)


def most_frequent(colors: NDArray[np.uint8], threshold: float) -> NDArray[np.uint8]:
    """Return of colors [T 3 ...] the one [3 ...] to which most others are within a threshold."""
    alike = np.zeros((len(colors), *colors.shape[2:]), np.int16)
    for a in range(len(colors) if alike.size else 0):
        for b in range(a + 1, len(colors)):
            same = _distance(colors[a], colors[b]) <= threshold
            alike[a] += same
            alike[b] += same
    return np.take_along_axis(colors, alike.argmax(axis=0)[None, None], axis=0)[0]


def color_and_change(rgb: NDArray[np.uint8], settings: ImageSettings) -> Image:
    """Return the network's input [T 10 S S] of images [T S S 3].

    The color about 0 (3); its difference from the usual color (3); its change since the frame
    before and to the next; the range over all frames; the share of frames with the usual color.
    Differences are on a logarithmic scale: a plain door changes by a few grey levels.
    """
    values = np.ascontiguousarray(np.moveaxis(rgb, 3, 1))
    usual = usual_color(values, settings)
    out = np.empty((len(values), FOREGROUND_CHANNELS, *values.shape[2:]), np.float32)
    out[:, :3] = values * np.float32(1 / 255) - np.float32(0.5)
    apart = values.astype(np.int16) - usual
    out[:, 3:6] = np.sign(apart) * _LEVEL[np.abs(apart)]
    out[0, 6] = out[-1, 7] = 0
    for t in range(1, len(values)):
        out[t, 6] = out[t - 1, 7] = _LEVEL[_distance(values[t - 1], values[t])]
    out[:, 8] = _LEVEL[(values.max(axis=0) - values.min(axis=0)).max(axis=0)]
    out[:, 9] = (np.abs(apart).max(axis=1) <= _SAME).mean(axis=0)
    return out


def _distance(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the largest difference [H W] of a channel [3 H W]."""
    return np.asarray(cv2.absdiff(a.reshape(3, -1), b.reshape(3, -1)), np.uint8).reshape(
        a.shape).max(axis=0)
