"""Surfaces of noisy depth: planes fitted to windows, each within its own layer of depth.

Noise of s per pixel leaves s / (2 r + 1) in the middle of a window of radius r, and slopes that are
good enough to align with. A window must not reach across an edge in depth: the median of a few
pixels says which layer a pixel is in, and the moments of each layer are box-filtered apart.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image, together
from .flow_types import Flow
from .surfaces import Surfaces

_RADIUS = 8  # px, of the windows that slopes are from
_CENTRE = 4  # px, of those that depths are from: curved surfaces are flattened with its square
_RIM = 5  # px; a round limb's rim shows its front where a point has turned to its back
_LAYER = 4.0  # spacing of the layers, in standard deviations of the median


def smoothed(
    depth: Image, rgb: NDArray[np.uint8], intrinsics: Array, noise: float, flow: Flow
) -> Surfaces:
    """Surfaces of depth [T H W] with independent noise of standard deviation `noise`, m.

    Only in and around what moves in the images [T H W 3]; flow goes with them.
    """
    lively = np.zeros(depth.shape[1:], np.uint8)
    for image in rgb[1:]:
        red, green, blue = cv2.split(cv2.absdiff(image, rgb[0]))
        lively |= (cv2.max(red, cv2.max(green, blue)) > 2).astype(np.uint8)
    lively = cv2.dilate(cv2.medianBlur(lively, 5), np.ones((21, 21), np.uint8)) > 0
    fitted = together(lambda d: fit_planes(d, lively, intrinsics, noise), depth)
    flows = np.zeros((len(depth) - 1, *lively.shape, 2), np.float32)
    if lively.any():
        v, u = np.nonzero(lively)
        box = (slice(max(0, v.min() - 16), v.max() + 17), slice(max(0, u.min() - 16), u.max() + 17))
        crops = [np.ascontiguousarray(image[box]) for image in rgb]
        steps = together(lambda pair: flow(*pair), pairwise(crops))
        flows[(slice(None), *box)] = np.stack(steps)
    left = noise / (2 * _CENTRE + 1)
    return Surfaces(
        np.stack([z for z, _ in fitted]),
        np.stack([n for _, n in fitted]),
        intrinsics,
        left,
        flows,
    )


def fit_planes(
    depth: Image, lively: NDArray[np.bool_], intrinsics: Array, noise: float
) -> tuple[Image, Image]:
    """Depth [H W] and normals [H W 3] of one frame; no normals outside `lively` [H W]."""
    valid = depth > 0
    rough = cv2.medianBlur(np.ascontiguousarray(depth, np.float32), 5)
    rough = np.where(valid & (rough > 0), rough, depth)
    spacing = _LAYER * noise / 3.0
    z, n = rough.copy(), np.zeros((*depth.shape, 3), np.float32)
    wanted = valid & lively
    if not wanted.any():
        return z, n
    low = float(rough[wanted].min())
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]].astype(np.float32)
    x = (u - np.float32(intrinsics[0, 2])) / np.float32(intrinsics[0, 0])
    y = (v - np.float32(intrinsics[1, 2])) / np.float32(intrinsics[1, 1])
    layer = np.rint((rough - low) / spacing).astype(np.int64)
    for k in np.unique(layer[wanted]):
        mine = wanted & (layer == k)
        v, u = np.nonzero(mine)
        pad = _RADIUS + 1
        box = (slice(max(0, v.min() - pad), v.max() + pad + 1),
               slice(max(0, u.min() - pad), u.max() + pad + 1))
        near = valid[box] & (np.abs(rough[box] - (low + k * spacing)) < 1.5 * spacing)
        take = mine[box]
        z[box][take], n[box][take] = window_planes(
            depth[box], near, x[box], y[box], low + float(k) * spacing, take)
    return z, n


def window_planes(
    depth: Image, mask: NDArray[np.bool_], x: Image, y: Image, around: float,
    take: NDArray[np.bool_],
) -> tuple[Image, Image]:
    """Least squares of z = a + b x + c y over the masked pixels of windows [H W]; depth [N] and
    normals [N 3] in the middle of those to take.

    Depth is taken relative to `around`, which keeps single precision good enough.
    """
    m = mask.astype(np.float32)
    x0, y0 = float(x.mean()), float(y.mean())
    at_x, at_y, at_z = x[take] - x0, y[take] - y0, depth[take]
    x, y, z = (x - x0) * m, (y - y0) * m, (depth - around) * m

    def means(radius: int, *channels: NDArray[np.floating[Any]]) -> list[Image]:
        size, edge = (2 * radius + 1, 2 * radius + 1), cv2.BORDER_CONSTANT
        blurred = [cv2.boxFilter(c, -1, size, normalize=True, borderType=edge) for c in channels]
        return [np.asarray(c[take], np.float32) for c in blurred]

    s = means(_RADIUS, m, x, y, x * x, x * y, y * y, z, x * z, y * z)
    w = np.maximum(s[0], 1e-9)
    mx, my, mz = s[1] / w, s[2] / w, s[6] / w
    xx, xy, yy = s[3] / w - mx * mx, s[4] / w - mx * my, s[5] / w - my * my
    xz, yz = s[7] / w - mx * mz, s[8] / w - my * mz
    ridge = 1e-2 * (xx + yy) + 1e-12
    xx, yy = xx + ridge, yy + ridge
    det = xx * yy - xy * xy
    b, c = (yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det
    t = means(_CENTRE, m, x, y, z)
    v = np.maximum(t[0], 1e-9)
    fitted = around + t[3] / v + b * (at_x - t[1] / v) + c * (at_y - t[2] / v)
    # the surface z(x, y) in rays: n ~ (-b, -c, z + b x + c y) / ..., away from the camera
    n = np.stack([-b, -c, fitted + b * (at_x + x0) + c * (at_y + y0)], axis=1)
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
    n[(means(_RIM // 2, m)[0] <= 0.95) | ~mask[take]] = 0.0
    return np.where(mask[take], fitted, at_z).astype(np.float32), n.astype(np.float32)
