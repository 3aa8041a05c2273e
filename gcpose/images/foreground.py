"""What moves in a video from a still camera: by a network, or by the usual color of each pixel.

A second network finds people, who are no part of an object.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import logit

from ...errors import ConfigError, suggestion
from ..numerics import Image
from .camera_noise import remove_camera_noise
from .foreground_input import (
    FOREGROUND_SIDE,
    Square,
    changing_pixels,
    changing_square,
    color_and_change,
    cut_square,
    most_frequent,
    paste_square,
)
from .foreground_network import (
    FOREGROUND_WEIGHTS,
    PEOPLE_WEIGHTS,
    ForegroundInference,
    load_foreground,
)
from .settings import ImageSettings

_NAMES = ("network", "network:WEIGHTS", "background", "no-people", "no-people:WEIGHTS")


class Foreground(Protocol):
    """Finds what moves; an attribute `training` names a network's data."""

    def __call__(self, rgb: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return where images [T H W 3] of a still camera show something that moves [T H W]."""
        ...


def find_foreground(name: str, settings: ImageSettings) -> Foreground:
    """Return the foreground of a name: one of `_NAMES`, where WEIGHTS stands for a file.

    Raises:
        ConfigError: If the name is unknown, or a file is missing or does not fit.
    """
    kind, colon, file = name.partition(":")
    if name == "background":
        return partial(subtract_background, settings=settings)
    if kind == "network" and bool(colon) == bool(file):
        return LearnedForeground(load_foreground(Path(file) if file else FOREGROUND_WEIGHTS),
                                 settings)
    if kind == "no-people" and bool(colon) == bool(file):
        people = load_foreground(Path(file) if file else PEOPLE_WEIGHTS, "people")
        return LearnedForeground(load_foreground(FOREGROUND_WEIGHTS), settings, people)
    raise ConfigError(
        f"no foreground {name!r}{suggestion(name, _NAMES)}; there are {', '.join(_NAMES)}")


class LearnedForeground:
    """The foreground of a network, which sees all frames at once."""

    training = "supervised: masks of synthetic video, for rgb and rgbd-noise"

    def __init__(
        self, network: ForegroundInference, settings: ImageSettings,
        people: ForegroundInference | None = None,
    ) -> None:
        """Take a network, the settings of its input, and a network that finds who is left out."""
        self._network, self._settings, self._people = network, settings, people

    def __call__(self, rgb: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return where images [T H W 3] show something that moves [T H W]."""
        rgb = remove_camera_noise(rgb, self._settings)
        square = changing_square(rgb, self._settings)
        if square is None:
            return np.zeros(rgb.shape[:3], bool)
        margin = _edge_margin(square, self._settings)
        logits = _run_on_square(self._network, rgb, square, self._settings)
        found = _compare_with_background(rgb, logits, margin, self._settings)
        if self._people is None:
            return found
        object_only = found & ~_enlarge(find_people(rgb, self._people, self._settings), margin)
        return np.stack([without_specks(mask, self._settings) for mask in object_only])


def find_people(
    rgb: NDArray[np.uint8], network: ForegroundInference, settings: ImageSettings
) -> NDArray[np.bool_]:
    """Return where images [T H W 3] of a still camera show people who move [T H W].

    People come from outside of the image: each piece, and what is near it, reaches the edge.
    """
    square = changing_square(rgb, settings)
    if square is None:
        return np.zeros(rgb.shape[:3], bool)
    logits = _run_on_square(network, rgb, square, settings)
    found = logits > float(logit(settings.person_probability))
    wide = _enlarge(found, _edge_margin(square, settings))
    return found & np.stack([_from_the_edge(mask) for mask in wide])


def _from_the_edge(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pieces of a mask [H W] that reach the edge of the image."""
    _, found = cv2.connectedComponents(mask.astype(np.uint8))
    piece = np.asarray(found, np.int64)
    sides = np.concatenate([piece[0], piece[-1], piece[:, 0], piece[:, -1]])
    return mask & np.isin(piece, sides)


def _edge_margin(square: Square, settings: ImageSettings) -> int:
    """Return how far the edges of a network's masks may be wrong, px of the image."""
    return max(1, round(settings.foreground_edge * square.side / FOREGROUND_SIDE))


def _run_on_square(
    network: ForegroundInference, rgb: NDArray[np.uint8], square: Square, settings: ImageSettings
) -> Image:
    """Return the logits [T H W] of images [T H W 3], of which the network sees a square."""
    logits = network(color_and_change(cut_square(rgb, square), settings))
    return np.stack([paste_square(frame, square, *rgb.shape[1:3]) for frame in logits])


def _enlarge(masks: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """Enlarge masks [T H W] by a margin, px."""
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1, 2 * margin + 1))
    return np.stack([cv2.dilate(mask.astype(np.uint8), window) for mask in masks]) > 0


def _compare_with_background(
    rgb: NDArray[np.uint8], logits: Image, margin: int, settings: ImageSettings
) -> NDArray[np.bool_]:
    """Return masks [T H W] of what differs from the background where the network sees motion.

    The network's pixels are coarser than those of an image, so that its masks are enlarged by
    `margin` px. The background of a pixel is its color in the frame in which the network is most
    sure that nothing moves there; where there is no such frame, the network decides.
    """
    found = logits > 0
    near = _enlarge(found, margin)
    free = np.where(near, np.float32(np.inf), logits)
    best = free.argmin(axis=0)[None]
    background = np.take_along_axis(rgb, best[..., None], axis=0)[0]
    known = np.isfinite(np.take_along_axis(free, best, axis=0)[0])
    live = changing_pixels(rgb, settings)
    out = np.empty(found.shape, bool)
    for t, image in enumerate(rgb):
        differs = cv2.absdiff(image, background).max(axis=2) > settings.background_threshold
        mask = np.where(known, near[t] & differs, found[t]).astype(np.uint8)
        out[t] = _clean_mask(mask, live, settings)
    return out


def without_specks(mask: NDArray[np.bool_], settings: ImageSettings) -> NDArray[np.bool_]:
    """Return a mask [H W] without pieces that are smaller than `min_foreground`."""
    _, found, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    large = stats[:, cv2.CC_STAT_AREA] >= settings.min_foreground
    large[0] = False
    return np.asarray(large[np.asarray(found, np.int64)], bool)


def subtract_background(rgb: NDArray[np.uint8], settings: ImageSettings) -> NDArray[np.bool_]:
    """Return where images [T H W 3] differ from the background [T H W].

    The background of a pixel is the color that it shows in most frames.
    """
    rgb = remove_camera_noise(rgb, settings)
    live = changing_pixels(rgb, settings)
    values = np.ascontiguousarray(np.moveaxis(rgb[:, live], 2, 1))
    apart = values.astype(np.int16) - most_frequent(values, settings.same_threshold)
    raw = np.zeros(rgb.shape[:3], np.uint8)
    raw[:, live] = np.abs(apart).max(axis=1) > settings.background_threshold
    return np.stack([_clean_mask(mask, live, settings) for mask in raw])


def _clean_mask(
    mask: NDArray[np.uint8], live: NDArray[np.bool_], settings: ImageSettings
) -> NDArray[np.bool_]:
    """Remove specks, and fill gaps, as where a plain surface hardly changes."""
    out = cv2.morphologyEx(cv2.medianBlur(mask, 3), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    count, found, stats, _ = cv2.connectedComponentsWithStats(1 - out, connectivity=4)
    label = np.asarray(found, np.int64)
    size = stats[:, cv2.CC_STAT_AREA]
    still = np.bincount(label.ravel(), weights=~live.ravel(), minlength=count) / np.maximum(1, size)
    gap = (size < settings.max_gap) | (
        (still > settings.static_gap_share) & (size < settings.max_static_gap))
    return without_specks((out > 0) | gap[label], settings)
