"""Motion of a camera that is held by hand: how the background moves in the images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import MethodError
from ...robots.geometry import Array
from ..numerics import thread_map
from .camera_noise import many_pixels_change
from .features import even_tone, follow_features, lucas_kanade
from .parallax import find_parallax
from .settings import ImageSettings

_FEATURES, _QUALITY, _SPACING = 1500, 0.002, 6  # of Shi and Tomasi; px
_BLUR = 1.0  # px
_MIN_FEATURES = 50  # in frame 0
_MIN_FOLLOWED = 20  # in another frame
_TOO_MUCH = ("the camera moves too much; put it on a stand, or take fewer seconds. If it stands "
             "still and the object fills most of the images, say so (--still)")
_CONSENSUS = 1.5  # px from the homography
_WINDOW, _LEVELS = 15, 4  # px; levels of the image pyramid


@dataclass(frozen=True)
class CameraMotion:
    """How what stands still moves in the images of T frames."""

    far: Array
    """[T 3 3] homographies from pixels of frame 0 to those of each frame, of what is infinitely far
    away; of most of the background, if no parallax is seen"""
    parallax: Array
    """[T 3] what one unit of inverse depth adds to the last columns of `far`"""
    place: Array
    """[N 2] features of frame 0 that stand still, px"""
    inverse_depth: Array
    """[N] of these, in a unit of its own"""
    shift: float
    """Largest motion of a corner of the image, px"""
    error: float
    """Distance from its place within which 90 % of what stands still is found in each frame, px"""
    explained: int | None = None
    """Number of features whose parallax one feature explains; None if there is no parallax"""

    def is_sure(self, settings: ImageSettings) -> bool:
        """Return whether the motion is known well."""
        few = self.explained is not None and self.explained < settings.sure_parallax
        return self.error <= settings.sure_background_error and not few

    def homography(self, inverse_depth: float) -> Array:
        """Return the homographies [T 3 3] of a plane that is parallel to the image of frame 0."""
        out = self.far.copy()
        out[..., 2] += inverse_depth * self.parallax
        return out / out[:, 2:, 2:]


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
    rgb: NDArray[np.uint8], intrinsics: Array, settings: ImageSettings
) -> CameraMotion | None:
    """Return how the camera of images [T H W 3] moves; None where it stands still in most frames,
    or where too few features show it.

    Features of frame 0 (Shi and Tomasi, 1994) are followed to each frame by Lucas and Kanade's
    method. A homography takes most of them along (MAGSAC++: Barath et al., 2020). The parallax of
    the others tells how the camera turns and moves.

    Raises:
        MethodError: If the camera moves too much.
    """
    s = settings
    if not many_pixels_change(rgb, s):
        return None
    tracks = _follow_strong_features(rgb)
    if not tracks:
        return None
    stays = [np.mean(t.distances(np.eye(3)) < s.still_distance)
             for t in tracks if len(t.start) >= _MIN_FOLLOWED]
    if stays and np.median(stays) >= s.still_share:
        return None
    if min(len(t.start) for t in tracks) < _MIN_FOLLOWED:
        raise MethodError(_TOO_MUCH)
    homography = np.stack([np.eye(3), *map(_homography, tracks)])
    shift = _largest_shift(homography, *rgb.shape[1:3])
    if shift > s.max_camera_shift * max(rgb.shape[1:3]):
        raise MethodError(_TOO_MUCH)
    features = follow_features(rgb, homography)
    parallax = find_parallax(features, homography[1:], intrinsics)
    distance = parallax.distance if parallax else np.where(
        features.found, np.linalg.norm(features.offsets(homography[1:]), axis=2), np.nan)
    near = distance < s.max_background_error
    count = features.found.sum(axis=1)
    still = (near.sum(axis=0) > features.found.sum(axis=0) / 2 if parallax is None
             else parallax.still)
    if not still.any() or np.any(near.sum(axis=1) < np.maximum(1, s.background_share * count)):
        raise MethodError(_TOO_MUCH)
    if parallax is None:
        return CameraMotion(homography, np.zeros((len(rgb), 3)), features.start[still],
                            np.zeros(int(still.sum())), shift, _error(distance[:, still]))
    far = intrinsics @ parallax.rotation @ np.linalg.inv(intrinsics)
    step = parallax.translation @ intrinsics.T
    return CameraMotion(np.concatenate([np.eye(3)[None], far]),
                        np.concatenate([np.zeros((1, 3)), step]), features.start[still],
                        parallax.inverse_depth[still], shift, _error(distance[:, still]),
                        parallax.explained)


def _error(distance: Array) -> float:
    """Return the largest of the 90 % quantiles of distances [T-1 N], px; NaN are not found."""
    return max((float(np.quantile(d[np.isfinite(d)], 0.9)) for d in distance
                if np.isfinite(d).any()), default=np.inf)


def _follow_strong_features(rgb: NDArray[np.uint8]) -> list[_Tracks]:
    """The strongest features of frame 0 that are found in each other frame, and found back from
    there; none if frame 0 has too few."""
    gray = [even_tone(image) for image in rgb]
    smooth = cv2.GaussianBlur(gray[0], (0, 0), _BLUR)
    found: Any = cv2.goodFeaturesToTrack(smooth, _FEATURES, _QUALITY, _SPACING)
    if found is None or len(found) < _MIN_FEATURES:
        return []
    start = np.asarray(found, np.float32)

    def follow(image: NDArray[np.uint8]) -> _Tracks:
        end, there = lucas_kanade(gray[0], image, start, _WINDOW, _LEVELS)
        again, back = lucas_kanade(image, gray[0], end, _WINDOW, _LEVELS)
        close = np.linalg.norm(again - start, axis=2) < 0.5
        good = (there > 0) & (back > 0) & close
        return _Tracks(*(points[good].astype(np.float64) for points in (start, end)))

    return thread_map(follow, gray[1:])


def _largest_shift(homography: Array, height: int, width: int) -> float:
    """Largest motion of a corner of an image by homographies [T 3 3], px."""
    corner = np.array([[[0, 0]], [[width, 0]], [[0, height]], [[width, height]]], np.float64)
    moved = [cv2.perspectiveTransform(corner, h) for h in homography]
    return float(np.linalg.norm(np.stack(moved) - corner, axis=-1).max())


def _homography(tracks: _Tracks) -> Array:
    found: Any = cv2.findHomography(tracks.start, tracks.end, cv2.USAC_MAGSAC, _CONSENSUS,
                                    maxIters=5000, confidence=0.999)[0]
    return np.eye(3) if found is None else np.asarray(found, np.float64)
