"""Features of frame 0 that are followed to the other frames of a video."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image, thread_map

_CONTRAST = 45.0  # standard deviation, grey levels
_BLUR = 1.0  # px
_CELLS, _LEAST_CELL, _PER_CELL = 20, 32, 5  # along the longer side; px; strongest features of each
_SPACING, _BORDER = 5, 8  # px
_QUALITY = 1e-5  # least eigenvalue of the structure tensor
_DEVIATION, _DEVIATION_BY_QUALITY = 0.15, 1e-5  # px; px^2
_PATCH = 13  # px
_LIKENESS = 0.85  # least correlation of patches
_RETURN = 0.3  # px
_CLEAR, _CLEARER, _UNLIKE = 0.7, 2.0, 0.02
"""A motion of more than the first, px, is seen if the difference of the patches, one minus their
correlation, is larger without it: by the factor and by the sum."""


@dataclass(frozen=True)
class FeatureTracks:
    """N features of frame 0 in T frames."""

    start: Array
    """[N 2] px"""
    end: Array
    """[T-1 N 2] px, in the other frames"""
    found: NDArray[np.bool_]
    """[T-1 N] whether a feature is found in a frame"""
    deviation: Array
    """[N] of a place, px: the weaker the texture, the larger"""

    def offsets(self, homography: Array) -> Array:
        """Return how far [T-1 N 2] features are from where homographies [T-1 3 3] take them, px."""
        return self.end - np.stack([cv2.perspectiveTransform(self.start[:, None], h)[:, 0]
                                    for h in homography])


def even_tone(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Brightness of an image [H W 3], of the usual mean and contrast: the exposure may change."""
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.float32)
    even = 128 + _CONTRAST / max(1.0, float(gray.std())) * (gray - gray.mean())
    return even.clip(0, 255).astype(np.uint8)


def lucas_kanade(
    first: NDArray[np.uint8], second: NDArray[np.uint8], points: Image, window: int, levels: int
) -> tuple[Image, NDArray[np.uint8]]:
    """Places [N 1 2] of points of an image in another one, and 1 for each that is found [N 1]."""
    at, found, _ = cv2.calcOpticalFlowPyrLK(first, second, points, points.copy(),
                                            winSize=(window, window), maxLevel=levels,
                                            criteria=(3, 30, 0.005))
    return np.asarray(at, np.float32), np.asarray(found, np.uint8)


def follow_features(rgb: NDArray[np.uint8], homography: Array) -> FeatureTracks:
    """Follow features of frame 0 of images [T H W 3], which are spread evenly over the image.

    Homographies [T 3 3] say about where they go: so a small window suffices. A feature is not found
    in a frame if it does not return to its place from there, if its patch differs, or if its patch
    fits nearly as well where the homography takes it: along an edge, and on weak texture, a motion
    is not seen.
    """
    gray = [even_tone(image) for image in rgb]
    start, quality = _find_features(gray[0])
    if not len(start):
        none = np.zeros((len(rgb) - 1, 0))
        return FeatureTracks(np.zeros((0, 2)), np.zeros((*none.shape, 2)), none > 0, np.zeros(0))

    def follow(image: NDArray[np.uint8], h: Array) -> tuple[Array, NDArray[np.bool_]]:
        size = gray[0].shape[::-1]
        near = np.asarray(cv2.warpPerspective(
            image, h, size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE), np.uint8)
        at, there = lucas_kanade(gray[0], near, start[:, None], _PATCH, 2)
        again, back = lucas_kanade(near, gray[0], at, _PATCH, 2)
        end = at[:, 0]
        patch = _patches(gray[0], start)
        likeness, unmoved = (np.sum(patch * _patches(near, p), axis=1) for p in (end, start))
        moves = np.linalg.norm(end - start, axis=1) > _CLEAR
        unclear = moves & (1 - unmoved < _CLEARER * (1 - likeness) + _UNLIKE)
        place = np.asarray(cv2.perspectiveTransform(at.astype(np.float64), h), np.float64)[:, 0]
        inside = ((place > _BORDER / 2) & (place < np.array(size) - _BORDER / 2)).all(axis=1)
        returns = np.linalg.norm(again - start[:, None], axis=2)[:, 0] < _RETURN
        seen = (there[:, 0] > 0) & (back[:, 0] > 0) & returns
        return place, seen & inside & ~unclear & (likeness > _LIKENESS)

    found = thread_map(lambda pair: follow(*pair), zip(gray[1:], homography[1:], strict=True))
    deviation = np.sqrt(_DEVIATION**2 + _DEVIATION_BY_QUALITY / quality)
    return FeatureTracks(start.astype(np.float64), np.stack([f[0] for f in found]),
                         np.stack([f[1] for f in found]), deviation.astype(np.float64))


def _find_features(gray: NDArray[np.uint8]) -> tuple[Image, Image]:
    """Return the strongest features [N 2] of each cell of an image (Shi and Tomasi, 1994), px, and
    their least eigenvalues [N]."""
    smooth = cv2.GaussianBlur(gray, (0, 0), _BLUR)
    quality = np.asarray(cv2.cornerMinEigenVal(smooth, 5), np.float32)
    around = np.ones((2 * _SPACING + 1,) * 2, np.uint8)
    corner = (quality == cv2.dilate(quality, around)) & (quality > _QUALITY)
    inner = np.zeros_like(corner)
    inner[_BORDER:-_BORDER, _BORDER:-_BORDER] = True
    v, u = np.nonzero(corner & inner)
    side = max(_LEAST_CELL, max(gray.shape) // _CELLS)
    cell = v // side * (gray.shape[1] // side + 1) + u // side
    order = np.lexsort((-quality[v, u], cell))
    v, u, cell = v[order], u[order], cell[order]
    rank = np.arange(len(cell)) - np.searchsorted(cell, cell)
    v, u = v[rank < _PER_CELL], u[rank < _PER_CELL]
    return np.stack([u, v], axis=1).astype(np.float32), quality[v, u]


def _patches(gray: NDArray[np.uint8], at: Image) -> Image:
    """Return patches [N P] around places [N 2], px, of mean 0 and length 1."""
    step = np.arange(_PATCH, dtype=np.float32) - _PATCH // 2
    dv, du = (d.ravel() for d in np.meshgrid(step, step, indexing="ij"))
    x, y = (np.ascontiguousarray(at[:, i, None] + d) for i, d in enumerate((du, dv)))
    sampled: Any = cv2.remap(gray, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    patch = np.asarray(sampled, np.float32)
    patch = patch - patch.mean(axis=1, keepdims=True)
    return patch / np.maximum(1e-3, np.linalg.norm(patch, axis=1, keepdims=True))
