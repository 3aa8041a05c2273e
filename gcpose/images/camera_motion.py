"""Motion of a camera that is held by hand: how the background moves in the images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import MethodError
from ...robots.geometry import Array
from ..numerics import Image, thread_map
from .camera_noise import many_pixels_change
from .settings import ImageSettings

_FEATURES, _QUALITY, _SPACING = 1500, 0.002, 6  # of Shi and Tomasi; px
_BLUR = 1.0  # px
_MIN_FEATURES = 50  # in frame 0
_MIN_FOLLOWED = 20  # in another frame
_TOO_MUCH = "the camera moves too much; put it on a stand, or take fewer seconds"
_CONTRAST = 45.0  # standard deviation, grey levels
_CONSENSUS = 1.5  # px from the homography


@dataclass(frozen=True)
class CameraMotion:
    """How the background of T frames moves."""

    homography: Array
    """[T 3 3] from pixels of frame 0 to those of each frame"""
    shift: float
    """Largest motion of a corner of the image, px"""
    error: float
    """Distance from where the homography takes it within which 90 % of the background is found in
    each frame, px"""


@dataclass(frozen=True)
class _Tracks:
    """N features of frame 0 that are found in another frame."""

    start: Array
    """[N 2] px"""
    end: Array
    """[N 2] px"""

    def distances(self, homography: Array) -> Array:
        """Distances [N] from where a homography takes them, px."""
        if not len(self.start):
            return np.zeros(0)
        moved = cv2.perspectiveTransform(self.start[:, None], homography)[:, 0]
        return np.asarray(np.linalg.norm(moved - self.end, axis=1))


def find_camera_motion(
    rgb: NDArray[np.uint8], settings: ImageSettings
) -> CameraMotion | None:
    """Return how the camera of images [T H W 3] moves; None where it stands still in most frames,
    or where too few features show it.

    Features of frame 0 (Shi and Tomasi, 1994) are followed to each frame by Lucas and Kanade's
    method. The homography is that of most of them (MAGSAC++: Barath et al., 2020): the motion of a
    background that is far away, or of one plane.

    Raises:
        MethodError: If the camera moves too much, or its background not as one plane.
    """
    s = settings
    if not many_pixels_change(rgb, s):
        return None
    tracks = _follow_features(rgb)
    if not tracks:
        return None
    still = [np.sum(t.distances(np.eye(3)) < s.still_distance) / max(1, len(t.start))
             for t in tracks]
    if np.median(still) >= s.still_share:
        return None
    if min(len(t.start) for t in tracks) < _MIN_FOLLOWED:
        raise MethodError(_TOO_MUCH)
    homography = np.stack([np.eye(3), *map(_homography, tracks)])
    shift = _largest_shift(homography, *rgb.shape[1:3])
    apart = [t.distances(h) for t, h in zip(tracks, homography[1:], strict=True)]
    near = [d[d < s.max_background_error] for d in apart]
    share = min(len(n) / len(d) for n, d in zip(near, apart, strict=True))
    if share < s.background_share or shift > s.max_camera_shift * max(rgb.shape[1:3]):
        raise MethodError(_TOO_MUCH)
    return CameraMotion(homography, shift, max(float(np.quantile(n, 0.9)) for n in near))


def align_frames(
    rgb: NDArray[np.uint8], motion: CameraMotion, settings: ImageSettings
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return images [T H W 3] as the camera of frame 0 would show them, and the pixels [H W] that
    all of them show. The others have the colors of frame 0."""
    height, width = rgb.shape[1:3]
    seen = np.full((height, width), 255, np.uint8)
    out, shown = rgb.copy(), seen.copy()
    for image, h in zip(out[1:], motion.homography[1:], strict=True):
        moved = cv2.warpPerspective(image, h, (width, height),
                                    flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
        inside = cv2.warpPerspective(seen, h, (width, height),
                                     flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
        image[...] = np.where(inside[..., None] > 0, moved, rgb[0])
        shown &= inside
    margin = 2 * settings.aligned_margin + 1
    inner = cv2.erode(shown, np.ones((margin, margin), np.uint8),
                      borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return out, np.asarray(inner > 0)


def move_labels_back(labels: NDArray[np.uint8], motion: CameraMotion) -> NDArray[np.uint8]:
    """Return labels [T H W] of aligned frames at the pixels of the frames before alignment."""
    size = labels.shape[2], labels.shape[1]
    return np.stack([
        np.asarray(cv2.warpPerspective(part, h, size, flags=cv2.INTER_NEAREST), np.uint8)
        for part, h in zip(labels, motion.homography, strict=True)])


def _follow_features(rgb: NDArray[np.uint8]) -> list[_Tracks]:
    """Features of frame 0 that are found in each other frame, and found back from there; none if
    frame 0 has too few."""
    gray = [_even_tone(image) for image in rgb]
    smooth = cv2.GaussianBlur(gray[0], (0, 0), _BLUR)
    found: Any = cv2.goodFeaturesToTrack(smooth, _FEATURES, _QUALITY, _SPACING)
    if found is None or len(found) < _MIN_FEATURES:
        return []
    start = np.asarray(found, np.float32)

    def follow(image: NDArray[np.uint8]) -> _Tracks:
        end, there = _lucas_kanade(gray[0], image, start)
        again, back = _lucas_kanade(image, gray[0], end)
        close = np.linalg.norm(again - start, axis=2) < 0.5
        good = (there > 0) & (back > 0) & close
        return _Tracks(*(points[good].astype(np.float64) for points in (start, end)))

    return thread_map(follow, gray[1:])


def _lucas_kanade(
    first: NDArray[np.uint8], second: NDArray[np.uint8], points: Image
) -> tuple[Image, NDArray[np.uint8]]:
    """Places [N 1 2] of points of an image in another one, and 1 for each that is found [N 1]."""
    at, found, _ = cv2.calcOpticalFlowPyrLK(first, second, points, points.copy(), winSize=(15, 15),
                                            maxLevel=4, criteria=(3, 30, 0.005))
    return np.asarray(at, np.float32), np.asarray(found, np.uint8)


def _even_tone(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Brightness of an image [H W 3], of the usual mean and contrast: the exposure may change."""
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.float32)
    even = 128 + _CONTRAST / max(1.0, float(gray.std())) * (gray - gray.mean())
    return even.clip(0, 255).astype(np.uint8)


def _largest_shift(homography: Array, height: int, width: int) -> float:
    """Largest motion of a corner of an image by homographies [T 3 3], px."""
    corner = np.array([[[0, 0]], [[width, 0]], [[0, height]], [[width, height]]], np.float64)
    moved = [cv2.perspectiveTransform(corner, h) for h in homography]
    return float(np.linalg.norm(np.stack(moved) - corner, axis=-1).max())


def _homography(tracks: _Tracks) -> Array:
    found: Any = cv2.findHomography(tracks.start, tracks.end, cv2.USAC_MAGSAC, _CONSENSUS,
                                    maxIters=5000, confidence=0.999)[0]
    return np.eye(3) if found is None else np.asarray(found, np.float64)
