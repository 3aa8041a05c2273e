"""Patches of a key frame found again in other frames, near where a hypothesis predicts them.

The iterations are those of inverse compositional Lucas-Kanade alignment (Baker and Matthews, IJCV
2004): gradients are of the patch, so that the normal matrix is computed once for each frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image, compiled
from .settings import ImageSettings


@dataclass(frozen=True)
class PredictedPatches:
    """N patches of key frames, with their predictions in T frames."""

    pixel: Array
    """[N 2] (u, v) of the center in the key frame"""
    frame: NDArray[np.int64]
    """[N] key frame"""
    place: Array
    """[N T 2] px, predicted center"""
    warp: Array
    """[N T 2 2] predicted distortion, frame from key frame"""
    wanted: NDArray[np.bool_]
    """[N T] whether to search in a frame"""
    channels: NDArray[np.bool_]
    """[N 2] whether a patch shows brightness, and the outline"""
    reach: float
    """Largest distance from the prediction, px"""


def find_patches(
    images: Image, patches: PredictedPatches, settings: ImageSettings
) -> tuple[Array, Array]:
    """Return centers [N T 2], px, of patches in images [T H W 2] (see `appearance`), and their
    information matrices [N T 2 2], 1/px^2: 0 where no patch was found.

    The offset of brightness is free. The outline counts only across its direction: along it, the
    outline of a round body does not move with the body. The error of the patch's model, which is
    another one for the outline alone, limits the information, and it is smaller where gradients are
    below the texture floor.
    """
    s = settings
    return _find(
        images, patches.pixel, patches.frame, patches.place, patches.warp, patches.wanted,
        patches.channels, s.patch_radius, patches.reach,
        (s.patch_sigma, s.patch_rate, s.outline_sigma, s.outline_rate), s.outline_contrast,
        s.patch_gain, s.patch_floor, s.patch_ridge, s.patch_ridge_floor, s.patch_iterations,
        s.max_patch_step, s.min_patch_step, s.min_patch_area, s.max_patch_area, s.texture_floor,
    )


@compiled
def _find(
    images: Image, pixel: Array, frame: NDArray[np.int64], place: Array, warp: Array,
    wanted: NDArray[np.bool_], channels: NDArray[np.bool_], radius: int, reach: float,
    errors: tuple[float, float, float, float], contrast: float, gain: float, floor: float,
    ridge: float, ridge_floor: float, iterations: int, max_step: float, min_step: float,
    min_area: float, max_area: float, texture_floor: float,
) -> tuple[Array, Array]:
    n, frames = wanted.shape
    height, width = images.shape[1:3]
    values = images.reshape(-1)
    found = place.copy()
    info = np.zeros((n, frames, 2, 2))
    size = (2 * radius + 1) ** 2
    patch, warped = np.zeros((11, size), np.float32), np.zeros((6, size), np.float32)
    _write_window(radius, patch)
    for i in range(n):
        u, v = int(np.rint(pixel[i, 0])), int(np.rint(pixel[i, 1]))
        if min(u, v) < radius + 1 or u >= width - radius - 1 or v >= height - radius - 1:
            continue
        m0, m1 = _read_patch(images[frame[i]], u, v, channels[i], contrast, patch)
        sigma, rate = errors[:2] if channels[i, 0] else errors[2:]
        for t in range(frames):
            if not wanted[i, t]:
                continue
            w = warp[i, t]
            det = w[0, 0] * w[1, 1] - w[0, 1] * w[1, 0]
            if det < min_area or det > max_area:
                continue
            hxx, hxy, hyy = _warp(w, det, patch, m0, warped)
            damping = ridge * (hxx + hyy) + ridge_floor
            dxx, dyy = hxx + damping, hyy + damping
            dd = dxx * dyy - hxy * hxy
            x0, y0 = place[i, t, 0], place[i, t, 1]
            x, y, ok, total = x0, y0, True, 0.0
            rim = 1 + radius * (abs(w[0, 0]) + abs(w[0, 1]) + abs(w[1, 0]) + abs(w[1, 1]))
            for _ in range(iterations):
                if not (rim < x < width - rim - 1 and rim < y < height - rim - 1):
                    ok = False
                    break
                rx, ry, total = _residuals(
                    values, t * height * width, width, x, y, patch, warped, m0)
                sx, sy = (dyy * rx - hxy * ry) / dd, (dxx * ry - hxy * rx) / dd
                length = np.sqrt(sx * sx + sy * sy)
                if length > max_step:
                    sx, sy = sx * max_step / length, sy * max_step / length
                x, y = x + sx, y + sy
                if (x - x0) ** 2 + (y - y0) ** 2 > reach * reach:
                    ok = False
                    break
                if length < min_step:
                    break
            if not ok:
                continue
            found[i, t, 0], found[i, t, 1] = x, y
            energy = (hxx + hyy) / m1
            trust = energy / (energy + texture_floor * texture_floor)
            variance = gain * (total / (m0 + m1)) + floor
            model = (sigma + rate * abs(t - frame[i])) ** 2
            _limit_information(
                hxx / variance, hxy / variance, hyy / variance, model, trust * trust, info[i, t])
    return found, info


# A patch of S pixels is a table in single precision, so that a loop over its pixels is compiled to
# instructions for several pixels. Rows [11 S]: 0, 1 offset x, y from the center; 2 window;
# 3, 4 values of both channels; 5, 6 and 7, 8 their gradients by x and y; 9, 10 their weights.
# Warped to a frame, rows [6 S]: 0, 1 offset; 2, 3 and 4, 5 gradients by x, y of both channels,
# multiplied by their weights.


@compiled
def _write_window(radius: int, patch: Image) -> None:
    size = 2 * radius + 1
    for k in range(size * size):
        x, y = k % size - radius, k // size - radius
        patch[0, k], patch[1, k] = x, y
        patch[2, k] = np.exp(-(x * x + y * y) / (radius * radius))


@compiled
def _read_patch(
    source: Image, u: int, v: int, channels: NDArray[np.bool_], contrast: float, patch: Image
) -> tuple[float, float]:
    """Read the patch, its gradients and weights; return the sum of the weights of brightness, and
    of the window."""
    half = np.float32(0.5)
    m0, m1 = 0.0, 0.0
    for k in range(patch.shape[1]):
        x, y, window = u + int(patch[0, k]), v + int(patch[1, k]), patch[2, k]
        for c in range(2):
            patch[3 + c, k] = source[y, x, c]
            patch[5 + c, k] = half * (source[y, x + 1, c] - source[y, x - 1, c])
            patch[7 + c, k] = half * (source[y + 1, x, c] - source[y - 1, x, c])
        inside = min(1.0, source[y, x, 1] / contrast)
        patch[9, k] = window * inside ** 6 if channels[0] else 0.0
        patch[10, k] = window if channels[1] else 0.0
        m0 += patch[9, k]
        m1 += window
    return m0, m1


@compiled
def _warp(
    w: Array, det: float, patch: Image, m0: float, warped: Image
) -> tuple[float, float, float]:
    """Write offsets and gradients in the target, w d and w^-T g; return the normal matrix."""
    w00, w01 = np.float32(w[0, 0]), np.float32(w[0, 1])
    w10, w11 = np.float32(w[1, 0]), np.float32(w[1, 1])
    i00, i01 = np.float32(w[1, 1] / det), np.float32(-w[1, 0] / det)
    i10, i11 = np.float32(-w[0, 1] / det), np.float32(w[0, 0] / det)
    zero = np.float32(0)
    mx, my, sxx, sxy, syy = zero, zero, zero, zero, zero
    for k in range(patch.shape[1]):
        warped[0, k] = w00 * patch[0, k] + w01 * patch[1, k]
        warped[1, k] = w10 * patch[0, k] + w11 * patch[1, k]
        ax, ay = (i00 * patch[5, k] + i01 * patch[7, k], i10 * patch[5, k] + i11 * patch[7, k])
        bx, by = (i00 * patch[6, k] + i01 * patch[8, k], i10 * patch[6, k] + i11 * patch[8, k])
        warped[2, k], warped[3, k], warped[4, k], warped[5, k] = ax, ay, bx, by
        mx += patch[9, k] * ax
        my += patch[9, k] * ay
        sxx += patch[10, k] * bx * bx
        sxy += patch[10, k] * bx * by
        syy += patch[10, k] * by * by
    if m0 > 0:
        mx, my = np.float32(mx / m0), np.float32(my / m0)
    # an outline counts only across its direction
    angle = 0.5 * np.arctan2(2 * sxy, sxx - syy)
    ex, ey = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    hxx, hxy, hyy = zero, zero, zero
    for k in range(patch.shape[1]):
        s0, s1 = patch[9, k], patch[10, k]
        ax, ay = warped[2, k] - mx, warped[3, k] - my
        along = warped[4, k] * ex + warped[5, k] * ey
        bx, by = along * ex, along * ey
        hxx += s0 * ax * ax + s1 * bx * bx
        hxy += s0 * ax * ay + s1 * bx * by
        hyy += s0 * ay * ay + s1 * by * by
        warped[2, k], warped[3, k], warped[4, k], warped[5, k] = s0 * ax, s0 * ay, s1 * bx, s1 * by
    return float(hxx), float(hxy), float(hyy)


@compiled
def _residuals(
    values: NDArray[np.float32], start: int, width: int, x: float, y: float, patch: Image,
    warped: Image, m0: float,
) -> tuple[float, float, float]:
    """Right-hand side rx, ry of a patch at (x, y), and its squared difference, bilinear.

    Values are those of all images in a row, of which this one has the pixel `start` as its first.
    """
    left, top = int(x), int(y)
    x_rest, y_rest = np.float32(x - left), np.float32(y - top)
    first = start + top * width + left
    zero = np.float32(0)
    mean, total, rx, ry = zero, zero, zero, zero
    for k in range(patch.shape[1]):
        tx, ty = x_rest + warped[0, k], y_rest + warped[1, k]
        column, row = np.floor(tx), np.floor(ty)
        fx, fy = tx - column, ty - row
        c11 = fx * fy
        c01, c10 = fx - c11, fy - c11
        c00 = np.float32(1) - fx - c10
        at = np.uint64(2 * (first + np.int64(row) * width + np.int64(column)))
        below = np.uint64(at + np.uint64(2 * width))
        a = patch[3, k] - (
            c00 * values[at] + c01 * values[at + np.uint64(2)]
            + c10 * values[below] + c11 * values[below + np.uint64(2)])
        b = patch[4, k] - (
            c00 * values[at + np.uint64(1)] + c01 * values[at + np.uint64(3)]
            + c10 * values[below + np.uint64(1)] + c11 * values[below + np.uint64(3)])
        mean += patch[9, k] * a
        total += patch[9, k] * a * a + patch[10, k] * b * b
        rx += warped[2, k] * a + warped[4, k] * b
        ry += warped[3, k] * a + warped[5, k] * b
    if m0 > 0:
        total -= np.float32(mean * mean / m0)
    return float(rx), float(ry), float(total)


@compiled
def _limit_information(
    a00: float, a01: float, a11: float, model: float, trust: float, out: Array
) -> None:
    """Write trust * (A^-1 + model I)^-1 = trust * A (I + model A)^-1."""
    b00, b01, b11 = 1 + model * a00, model * a01, 1 + model * a11
    bd = b00 * b11 - b01 * b01
    out[0, 0] = trust * (a00 * b11 - a01 * b01) / bd
    out[0, 1] = trust * (-a00 * b01 + a01 * b00) / bd
    out[1, 0] = out[0, 1]
    out[1, 1] = trust * (-a01 * b01 + a11 * b00) / bd
