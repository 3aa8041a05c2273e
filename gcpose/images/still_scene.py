"""What stands still before a camera that moves, at any depth, and what moves before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image, thread_map
from .camera_motion import CameraMotion
from .camera_noise import blur_image, moving_regions
from .settings import ImageSettings

_USUAL = 0.6  # Share of the frames in which what stands still is seen.
_EXTREMES = (0.02, 0.98)  # Quantiles of the inverse depths.
_FEW_FRAMES = 8  # that show about where something moves
_STRIDE = 3  # px from one pixel to the next of those whose changes show the noise
_BOX_MARGIN = 0.3  # of the sides of the box around what moves
_NEAREST, _NEAR_SHARE = 8, 0.7
"""The object is where features have at least this share of the inverse depth of the eighth."""


@dataclass(frozen=True)
class _Level:
    """What stands still at one inverse depth, in frame 0."""

    homography: Array
    """[T 3 3]"""
    low: NDArray[np.uint8]
    high: NDArray[np.uint8]
    """[H W 3] range of its colors within one pixel"""
    spread: Image
    """[H W] by how many grey levels the frames differ around each pixel"""


def show_still_scene(
    rgb: NDArray[np.uint8], motion: CameraMotion, settings: ImageSettings
) -> tuple[NDArray[np.uint8], Array]:
    """Return images [T H W 3] as a camera in the place of frame 0 would show them, and the
    homographies [T 3 3] from them to the images as they are.

    What moves is shown as if it were as far away as the object. A pixel stands still if a depth
    exists at which it has the color that the frames usually show there. It then has the color of
    frame 0's view, so that only what moves changes.
    """
    s = settings
    depths = _inverse_depths(motion, s)
    blurred = [blur_image(image, s).round().astype(np.uint8) for image in rgb]
    levels = thread_map(lambda d: _find_level(blurred, motion.homography(d), s), depths)
    spread = np.stack([level.spread for level in levels])
    fits = spread <= spread.min(axis=0) + s.level_rest
    shown = _common_view(rgb.shape[1:3], [levels[0].homography, levels[-1].homography], s)

    def changes(frames: NDArray[np.int64], plane: Array) -> NDArray[np.uint8]:
        return np.stack(thread_map(
            lambda t: shown * _change(blurred[t], t, plane[t], levels, fits), frames))

    few = np.unique(np.linspace(0, len(rgb) - 1, _FEW_FRAMES).astype(int))
    middle = motion.homography(float(np.median(depths)))
    moving = _find_moving(changes(few, middle), s)
    plane = motion.homography(_object_depth(motion, np.any(moving, axis=0)))
    moving = _find_moving(changes(np.arange(len(rgb)), plane), s)
    usual = np.where(shown[..., None], _usual_image(rgb, motion, depths[spread.argmin(axis=0)], s),
                     rgb[0])
    size = rgb.shape[2], rgb.shape[1]
    out = np.stack([
        np.where(m[..., None], cv2.warpPerspective(
            image, h, size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP), usual)
        for image, h, m in zip(rgb, plane, moving, strict=True)])
    return out.astype(np.uint8), plane


def _inverse_depths(motion: CameraMotion, settings: ImageSettings) -> Array:
    """Return inverse depths [K] between which what stands still is, so dense that the image shifts
    by a pixel from one to the next."""
    least, most = np.quantile(motion.inverse_depth, _EXTREMES)
    shift = float(np.linalg.norm(motion.parallax[:, :2], axis=1).max()) * (most - least)
    steps = int(np.clip(np.ceil(shift / settings.level_step), 0, settings.max_levels - 1))
    return np.linspace(least, most, steps + 1)


def _some_frames(count: int, settings: ImageSettings) -> NDArray[np.int64]:
    """Return the numbers of the frames that tell what is usual."""
    return np.linspace(0, count - 1, min(count, settings.foreground_frames)).astype(int)


def _to_frame_0(image: NDArray[np.uint8], homography: Array) -> NDArray[np.uint8]:
    return np.asarray(cv2.warpPerspective(
        image, homography, (image.shape[1], image.shape[0]),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def _find_level(
    blurred: list[NDArray[np.uint8]], homography: Array, settings: ImageSettings
) -> _Level:
    frames = _some_frames(len(blurred), settings)
    seen = np.stack([_to_frame_0(blurred[t], homography[t]) for t in frames])
    middle = len(seen) // 2
    usual = np.partition(seen, middle, axis=0)[middle]
    change = np.stack([_largest_channel(cv2.absdiff(image, usual)) for image in seen])
    most = min(len(seen) - 1, round(_USUAL * len(seen)))
    spread = np.partition(change, most, axis=0)[most].astype(np.float32)
    side = round(settings.level_window)
    around = np.ones((3, 3), np.uint8)
    return _Level(homography, np.asarray(cv2.erode(usual, around), np.uint8),
                  np.asarray(cv2.dilate(usual, around), np.uint8),
                  np.asarray(cv2.blur(spread, (side, side)), np.float32))


def _largest_channel(image: Any) -> NDArray[np.uint8]:
    red, green, blue = cv2.split(image)
    return np.asarray(cv2.max(cv2.max(red, green), blue), np.uint8)


def _change(
    image: NDArray[np.uint8], t: int, plane: Array, levels: list[_Level],
    fits: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Return by how many grey levels [H W] each pixel of a frame, seen on a plane, differs from all
    that stands still where it would be."""
    out: Any = None
    for level, here in zip(levels, fits, strict=True):
        seen = _to_frame_0(image, level.homography[t])
        change = _largest_channel(
            cv2.max(cv2.subtract(seen, level.high), cv2.subtract(level.low, seen)))
        change[~here] = 255
        moved = _to_frame_0(change, np.linalg.inv(level.homography[t]) @ plane)
        out = moved if out is None else cv2.min(out, moved)
    return np.asarray(out, np.uint8)


def _common_view(
    shape: tuple[int, ...], homographies: list[Array], settings: ImageSettings
) -> NDArray[np.bool_]:
    """Return the pixels [H W] of frame 0 that all frames show, away from their borders."""
    height, width = shape
    full = np.full((height, width), 255, np.uint8)
    shown = full.copy()
    for h in np.concatenate(homographies):
        shown &= np.asarray(cv2.warpPerspective(
            full, h, (width, height), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP), np.uint8)
    margin = 2 * settings.aligned_margin + 1
    inner = cv2.erode(shown, np.ones((margin, margin), np.uint8),
                      borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(inner > 0)


def _find_moving(change: NDArray[np.uint8], settings: ImageSettings) -> NDArray[np.bool_]:
    """Return what moves [T H W]: regions that change much, and where these are in any frame, pixels
    that change slightly; a plain surface that moves in itself changes only there."""
    s = settings
    largest = change[:, ::_STRIDE, ::_STRIDE].max(axis=0)
    noise = float(np.clip(np.median(largest), s.min_noise_aligned, s.max_noise))
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * s.moving_gap + 1,) * 2)

    def close(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, disk) > 0)

    moving = np.stack([
        close(moving_regions(c.astype(np.float32), noise, s.min_strong_aligned, s))
        for c in change])
    ever = moving.any(axis=0)
    slight = [close((c > s.slight_change) & ever) for c in change]
    return moving | np.stack(slight)


def _object_depth(motion: CameraMotion, moving: NDArray[np.bool_]) -> float:
    """Return the inverse depth of the object: that of the nearest features around what moves most
    [H W], since it stands before its background."""
    near = np.ones(len(motion.place), np.bool_)
    count, _, stats, _ = cv2.connectedComponentsWithStats(moving.astype(np.uint8))
    if count > 1:
        left, top, width, height, _ = stats[1 + stats[1:, 4].argmax()]
        size = np.array([width, height])
        inner = np.array([left, top]) + size / 2
        near = np.all(np.abs(motion.place - inner) < (0.5 + _BOX_MARGIN) * size, axis=1)
    if near.sum() <= _NEAREST:
        near[:] = True
    depth = motion.inverse_depth[near]
    least = np.sort(depth)[-min(_NEAREST, len(depth))] * _NEAR_SHARE
    return float(np.median(depth[depth >= least]))


def _usual_image(
    rgb: NDArray[np.uint8], motion: CameraMotion, depth: Array, settings: ImageSettings
) -> NDArray[np.uint8]:
    """Return the median color [H W 3] of each pixel of frame 0 at its inverse depth [H W]."""
    height, width = depth.shape
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    pixel = np.stack([u, v, np.ones_like(u)])

    def look(t: int) -> NDArray[np.uint8]:
        x, y, z = np.einsum("ij,jvu->ivu", motion.far[t], pixel) + (
            motion.parallax[t][:, None, None] * depth)
        return np.asarray(cv2.remap(rgb[t], (x / z).astype(np.float32), (y / z).astype(np.float32),
                                    cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)

    seen = np.stack(thread_map(look, _some_frames(len(rgb), settings)))
    return np.partition(seen, len(seen) // 2, axis=0)[len(seen) // 2]
