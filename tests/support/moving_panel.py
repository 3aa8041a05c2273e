"""A panel that moves before a wall, as a camera and a codec show it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .ray_scenes import texture

Video = NDArray[np.uint8]
Masks = NDArray[np.bool_]


def moving_panel(height: int = 60, width: int = 80) -> tuple[Video, Masks]:
    """A panel of this size before a wall, which moves by 7 px in each frame, and where it is."""
    rng = np.random.default_rng(3)
    wall, panel = texture(rng, 240, 320, 3.0), texture(rng, height, width, 2.0)
    rgb, true = np.repeat(wall[None], 12, axis=0), np.zeros((12, 240, 320), bool)
    for t in range(12):
        place = np.s_[t, 20 : 20 + height, 10 + 7 * t : 10 + 7 * t + width]
        rgb[place], true[place] = panel, True
    return rgb, true


def with_noise(rgb: Video, deviation: float) -> Video:
    noisy = rgb + np.random.default_rng(4).normal(0, deviation, rgb.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def with_codec(rgb: Video) -> Video:
    """Return images whose quality varies, as that of the frames of a compressed video does."""
    out = []
    for image, quality in zip(rgb, 2 * [80, 94, 96, 97, 92, 96], strict=True):
        _, file = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        out.append(np.asarray(cv2.imdecode(file, cv2.IMREAD_COLOR), np.uint8))
    return np.stack(out)


def with_shake(rgb: Video, largest: float = 8.0) -> tuple[Video, NDArray[np.float64]]:
    """Return what a camera sees that is held by hand, and the homographies [T 3 3] from pixels of
    frame 0 to those of each frame; a pixel moves by about `largest` at most."""
    height, width = rgb.shape[1:3]
    k = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]], np.float64)
    time = np.linspace(0, 5, len(rgb))[:, None]
    turn = np.sin(time * [1.0, 1.3, 0.7]) * [0.7, 0.7, 0.4] * largest / width
    moved = [k @ cv2.Rodrigues(r)[0] @ np.linalg.inv(k) for r in turn]
    images = [cv2.warpPerspective(image, h, (width, height), flags=cv2.INTER_CUBIC,
                                  borderMode=cv2.BORDER_REFLECT)
              for image, h in zip(rgb, moved, strict=True)]
    return np.stack(images).astype(np.uint8), np.stack(moved)


def before_a_near_board(steps: int = 12) -> tuple[Video, Masks, NDArray[np.float64]]:
    """A panel that moves on a plain board before a wall far away, as a hand-held camera sees them;
    where the panel is on the board of frame 0, and how the board [T 2] moves in the image, px."""
    rng = np.random.default_rng(7)
    wall, panel = texture(rng, 240, 320, 3.0), texture(rng, 40, 50, 2.0)
    board = np.full((240, 320, 3), 150, np.uint8)
    for u, v in rng.integers([70, 60], [240, 170], (30, 2)):  # what is written on it
        cv2.putText(board, "aR4"[(u + v) % 3], (int(u), int(v)), cv2.FONT_HERSHEY_SIMPLEX, 0.5,
                    (40,) * 3)
    time = np.linspace(0, 6, steps)[:, None]
    turn, off = 4 * np.sin(time * [1.0, 1.7]), 5 * np.sin(time * [2.1, 1.3])
    rgb, true = np.empty((steps, 240, 320, 3), np.uint8), np.zeros((steps, 240, 320), bool)
    for t in range(steps):
        near, shape = board.copy(), np.zeros((240, 320), np.uint8)
        place = np.s_[130 : 170, 80 + 8 * t : 130 + 8 * t]
        near[place], true[t][place], shape[50:190, 60:260] = panel, True, 255
        far, (near, shape) = _shift(wall, turn[t]), (_shift(i, turn[t] + off[t])
                                                     for i in (near, shape))
        rgb[t] = np.where(shape[..., None] > 127, near, far)
    return rgb, true, turn + off


def _shift(image: NDArray[np.uint8], by: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return an image that moves by (u, v), px."""
    size = image.shape[1], image.shape[0]
    return np.asarray(cv2.warpAffine(image, np.array([[1, 0, by[0]], [0, 1, by[1]]]), size,
                                     flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT),
                      np.uint8)


def overlap(found: Masks, true: Masks) -> float:
    return float((found & true).sum() / (found | true).sum())
