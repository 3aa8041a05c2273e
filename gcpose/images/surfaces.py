"""Surface elements of depth images: a point and a normal at every pixel of every frame.

Exact depth has normals by differences. For noisy depth, planes are fitted to windows, each within
its own layer of depth: noise of s per pixel leaves s / (2 r + 1) in the center of a window of
radius r. A window must not reach across an edge in depth: the median of a few pixels gives each
pixel's layer, and the moments of each layer are box-filtered separately.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, pinhole
from ..numerics import Image, thread_map
from .flow import Flow
from .regions import bounding_box
from .settings import ImageSettings


@dataclass(frozen=True)
class Surfaces:
    """Surface elements of T frames of H x W pixels."""

    depth: Image
    """[T H W] m, 0 = no surface"""
    normal: Image
    """[T H W 3] unit, away from the camera; zeros where unknown"""
    intrinsics: Array
    """[3 3] px"""
    noise: float
    """Standard deviation of the depth, m"""
    settings: ImageSettings
    flow: Image | None = None
    """[T-1 H W 2] px, to the next frame, where depth is noisy"""

    @property
    def frames(self) -> int:
        """T."""
        return len(self.depth)

    def footprint(self, z: Array) -> Array:
        """Return the size of a pixel on a surface at depth z, m."""
        return z / float(self.intrinsics[0, 0])

    def tolerance(self, z: Image) -> Image:
        """Return the largest difference of two measurements of a static surface at depth z, m."""
        s = self.settings
        constant = s.static_depth + s.static_noise * self.noise
        return np.float32(s.static_pixels / self.intrinsics[0, 0]) * z + np.float32(constant)

    def points(self, frame: int, pixel: NDArray[np.int64]) -> Array:
        """Return the points [N 3] of a frame at pixels (u, v) [N 2]."""
        return pinhole.unproject(
            self.intrinsics, pixel, self.depth[frame, pixel[:, 1], pixel[:, 0]])


def surfaces_from_depth(depth: Image, intrinsics: Array, settings: ImageSettings) -> Surfaces:
    """Return the surfaces of exact depth [T H W] m."""
    normal = np.stack(thread_map(lambda d: surface_normals(d, intrinsics, settings), depth))
    return Surfaces(np.ascontiguousarray(depth, np.float32), normal, intrinsics, 0.0, settings)


def surface_normals(depth: Image, intrinsics: Array, settings: ImageSettings) -> Image:
    """Return the normals [H W 3] of a depth image [H W]; zeros at edges and at grazing angles.

    Where n . X = d, the inverse depth (n / d) . ray is affine in the pixel: its gradient is the
    normal.
    """
    rough = settings.max_curvature / float(intrinsics[0, 0])
    valid = depth > 0
    q = np.where(valid, 1.0 / np.where(valid, depth, 1.0), 0.0).astype(np.float32)
    du, dv = np.zeros_like(q), np.zeros_like(q)
    ok = valid.copy()
    ok[[0, -1]] = ok[:, [0, -1]] = False
    du[:, 1:-1] = q[:, 2:] - q[:, :-2]
    dv[1:-1] = q[2:] - q[:-2]
    bend_u = np.abs(q[:, 2:] + q[:, :-2] - 2 * q[:, 1:-1])
    bend_v = np.abs(q[2:] + q[:-2] - 2 * q[1:-1])
    ok[:, 1:-1] &= bend_u < rough * q[:, 1:-1]
    ok[1:-1] &= bend_v < rough * q[1:-1]
    a = du * np.float32(0.5 * intrinsics[0, 0])
    b = dv * np.float32(0.5 * intrinsics[1, 1])
    height, width = depth.shape
    x = ((np.arange(width) - intrinsics[0, 2]) / intrinsics[0, 0]).astype(np.float32)
    y = ((np.arange(height) - intrinsics[1, 2]) / intrinsics[1, 1]).astype(np.float32)[:, None]
    n = np.stack([a, b, q - a * x - b * y], axis=2)
    length = np.sqrt(np.einsum("hwc,hwc->hw", n, n))
    facing = q > settings.min_normal_cosine * length * np.sqrt(1 + x * x + y * y)  # n . ray = q
    n /= np.maximum(length, 1e-12)[..., None]
    n[~(ok & facing)] = 0
    return n


def surfaces_from_noisy_depth(
    depth: Image, rgb: NDArray[np.uint8], intrinsics: Array, noise: float, flow: Flow,
    settings: ImageSettings,
) -> Surfaces:
    """Return the surfaces of depth [T H W] m with independent noise of a standard deviation, m.

    Planes are fitted, and flow is computed, only in and around what moves in the images [T H W 3].
    """
    moving = _changing_region(rgb, settings)
    fitted = thread_map(lambda d: fit_planes(d, moving, intrinsics, noise, settings), depth)
    flows = np.zeros((len(depth) - 1, *moving.shape, 2), np.float32)
    if moving.any():
        box = bounding_box(moving, settings.noisy_crop_margin)
        crops = [np.ascontiguousarray(image[box]) for image in rgb]
        steps = thread_map(lambda pair: flow(*pair), pairwise(crops))
        flows[(slice(None), *box)] = np.stack(steps)
    left = noise / (2 * settings.plane_center_radius + 1)
    z, n = (np.stack(images) for images in zip(*fitted, strict=True))
    return Surfaces(z, n, intrinsics, left, settings, flows)


def _changing_region(rgb: NDArray[np.uint8], settings: ImageSettings) -> NDArray[np.bool_]:
    """Pixels [H W] that change, and those around them."""
    changing = np.zeros(rgb.shape[1:3], np.uint8)
    for image in rgb[1:]:
        red, green, blue = cv2.split(cv2.absdiff(image, rgb[0]))
        most = cv2.max(red, cv2.max(green, blue))
        changing |= (most > settings.noisy_change_threshold).astype(np.uint8)
    window = np.ones((settings.noisy_margin, settings.noisy_margin), np.uint8)
    return cv2.dilate(cv2.medianBlur(changing, 5), window) > 0


def fit_planes(
    depth: Image, wanted: NDArray[np.bool_], intrinsics: Array, noise: float,
    settings: ImageSettings,
) -> tuple[Image, Image]:
    """Return depth [H W] and normals [H W 3] of one frame; no normals outside `wanted` [H W]."""
    valid = depth > 0
    rough = cv2.medianBlur(np.ascontiguousarray(depth, np.float32), 5)
    rough = np.where(valid & (rough > 0), rough, depth)
    spacing = settings.layer_spacing * noise / 3.0
    z, n = rough.copy(), np.zeros((*depth.shape, 3), np.float32)
    wanted = valid & wanted
    if not wanted.any():
        return z, n
    low = float(rough[wanted].min())
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]].astype(np.float32)
    x = (u - np.float32(intrinsics[0, 2])) / np.float32(intrinsics[0, 0])
    y = (v - np.float32(intrinsics[1, 2])) / np.float32(intrinsics[1, 1])
    layer = np.rint((rough - low) / spacing).astype(np.int64)
    for k in np.unique(layer[wanted]):
        mine = wanted & (layer == k)
        box = bounding_box(mine, settings.plane_radius + 1)
        near = valid[box] & (np.abs(rough[box] - (low + k * spacing)) < 1.5 * spacing)
        take = mine[box]
        window = _Window(depth[box], near, x[box], y[box], take)
        z[box][take], n[box][take] = _fit_window(window, low + float(k) * spacing, settings)
    return z, n


@dataclass(frozen=True)
class _Window:
    """A piece [H W] of a depth image that shows a layer."""

    depth: Image
    mask: NDArray[np.bool_]
    """Pixels of the layer"""
    x: Image
    """Rays at depth 1"""
    y: Image
    take: NDArray[np.bool_]
    """Pixels where a plane is wanted"""

    def means(self, radius: int, *channels: NDArray[np.floating[Any]]) -> list[Image]:
        """Means [N] of channels [H W] over windows around the wanted pixels."""
        size, edge = (2 * radius + 1, 2 * radius + 1), cv2.BORDER_CONSTANT
        blurred = [cv2.boxFilter(c, -1, size, normalize=True, borderType=edge) for c in channels]
        return [np.asarray(c[self.take], np.float32) for c in blurred]


def _fit_window(window: _Window, around: float, settings: ImageSettings) -> tuple[Image, Image]:
    """Depth [N] and normals [N 3] of the wanted pixels, by least squares of z = a + b x + c y.

    Depth is taken relative to `around`, so that single precision suffices.
    """
    take, mask = window.take, window.mask
    m = mask.astype(np.float32)
    x0, y0 = float(window.x.mean()), float(window.y.mean())
    at_x, at_y, at_z = window.x[take] - x0, window.y[take] - y0, window.depth[take]
    x, y, z = (window.x - x0) * m, (window.y - y0) * m, (window.depth - around) * m
    s = window.means(settings.plane_radius, m, x, y, x * x, x * y, y * y, z, x * z, y * z)
    w = np.maximum(s[0], 1e-9)
    mx, my, mz = s[1] / w, s[2] / w, s[6] / w
    xx, xy, yy = s[3] / w - mx * mx, s[4] / w - mx * my, s[5] / w - my * my
    xz, yz = s[7] / w - mx * mz, s[8] / w - my * mz
    ridge = settings.plane_ridge * (xx + yy) + 1e-12
    xx, yy = xx + ridge, yy + ridge
    det = xx * yy - xy * xy
    b, c = (yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det
    t = window.means(settings.plane_center_radius, m, x, y, z)
    v = np.maximum(t[0], 1e-9)
    fitted = around + t[3] / v + b * (at_x - t[1] / v) + c * (at_y - t[2] / v)
    # the surface z(x, y) in rays: n ~ (-b, -c, z + b x + c y) / ..., away from the camera
    n = np.stack([-b, -c, fitted + b * (at_x + x0) + c * (at_y + y0)], axis=1)
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
    n[(window.means(settings.rim_width // 2, m)[0] <= settings.rim_share) | ~mask[take]] = 0.0
    return np.where(mask[take], fitted, at_z).astype(np.float32), n.astype(np.float32)
