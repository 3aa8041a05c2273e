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
    found = place.copy()
    info = np.zeros((n, frames, 2, 2))
    size = 2 * radius + 1
    template, weight = np.zeros((2, size, size)), np.zeros((2, size, size))
    gx, gy = np.zeros((2, size, size)), np.zeros((2, size, size))
    px, py = np.zeros((2, size, size)), np.zeros((2, size, size))
    window = np.zeros((size, size))
    for a in range(size):
        for b in range(size):
            window[a, b] = np.exp(-((a - radius) ** 2 + (b - radius) ** 2) / (radius * radius))
    for i in range(n):
        u, v = int(np.rint(pixel[i, 0])), int(np.rint(pixel[i, 1]))
        if min(u, v) < radius + 1 or u >= width - radius - 1 or v >= height - radius - 1:
            continue
        m0, m1 = _read_template(
            images[frame[i]], u, v, window, channels[i], contrast, template, gx, gy, weight)
        sigma, rate = errors[:2] if channels[i, 0] else errors[2:]
        for t in range(frames):
            if not wanted[i, t]:
                continue
            w = warp[i, t]
            det = w[0, 0] * w[1, 1] - w[0, 1] * w[1, 0]
            if det < min_area or det > max_area:
                continue
            hxx, hxy, hyy = _warp_gradients(w, det, gx, gy, weight, m0, px, py)
            damping = ridge * (hxx + hyy) + ridge_floor
            dxx, dyy = hxx + damping, hyy + damping
            dd = dxx * dyy - hxy * hxy
            x0, y0 = place[i, t, 0], place[i, t, 1]
            x, y, ok, total = x0, y0, True, 0.0
            for _ in range(iterations):
                rim = 1 + radius * (abs(w[0, 0]) + abs(w[0, 1]) + abs(w[1, 0]) + abs(w[1, 1]))
                if not (rim < x < width - rim - 1 and rim < y < height - rim - 1):
                    ok = False
                    break
                rx, ry, total = _residuals(images[t], x, y, w, template, weight, px, py, m0)
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


@compiled
def _read_template(
    source: Image, u: int, v: int, window: Array, channels: NDArray[np.bool_], contrast: float,
    template: Array, gx: Array, gy: Array, weight: Array,
) -> tuple[float, float]:
    """Read the patch, its gradients and weights [2 S S]; return the sum of the weights of
    brightness, and of the window."""
    size, radius = len(window), len(window) // 2
    m0, m1 = 0.0, 0.0
    for a in range(size):
        for b in range(size):
            y, x = v + a - radius, u + b - radius
            for c in range(2):
                template[c, a, b] = source[y, x, c]
                gx[c, a, b] = 0.5 * (source[y, x + 1, c] - source[y, x - 1, c])
                gy[c, a, b] = 0.5 * (source[y + 1, x, c] - source[y - 1, x, c])
            inside = min(1.0, template[1, a, b] / contrast)
            weight[0, a, b] = window[a, b] * inside ** 6 if channels[0] else 0.0
            weight[1, a, b] = window[a, b] if channels[1] else 0.0
            m0 += weight[0, a, b]
            m1 += window[a, b]
    return m0, m1


@compiled
def _warp_gradients(
    w: Array, det: float, gx: Array, gy: Array, weight: Array, m0: float, px: Array, py: Array
) -> tuple[float, float, float]:
    """Write the gradients px, py [2 S S] in the target, warp^-T g; return the normal matrix."""
    size = gx.shape[1]
    i00, i01, i10, i11 = w[1, 1] / det, -w[1, 0] / det, -w[0, 1] / det, w[0, 0] / det
    mx, my = 0.0, 0.0
    sxx, sxy, syy = 0.0, 0.0, 0.0
    for a in range(size):
        for b in range(size):
            for c in range(2):
                px[c, a, b] = i00 * gx[c, a, b] + i01 * gy[c, a, b]
                py[c, a, b] = i10 * gx[c, a, b] + i11 * gy[c, a, b]
            mx += weight[0, a, b] * px[0, a, b]
            my += weight[0, a, b] * py[0, a, b]
            sxx += weight[1, a, b] * px[1, a, b] ** 2
            sxy += weight[1, a, b] * px[1, a, b] * py[1, a, b]
            syy += weight[1, a, b] * py[1, a, b] ** 2
    if m0 > 0:
        mx, my = mx / m0, my / m0
    # an outline counts only across its direction
    angle = 0.5 * np.arctan2(2 * sxy, sxx - syy)
    ex, ey = np.cos(angle), np.sin(angle)
    hxx, hxy, hyy = 0.0, 0.0, 0.0
    for a in range(size):
        for b in range(size):
            px[0, a, b] -= mx
            py[0, a, b] -= my
            along = px[1, a, b] * ex + py[1, a, b] * ey
            px[1, a, b], py[1, a, b] = along * ex, along * ey
            for c in range(2):
                hxx += weight[c, a, b] * px[c, a, b] ** 2
                hxy += weight[c, a, b] * px[c, a, b] * py[c, a, b]
                hyy += weight[c, a, b] * py[c, a, b] ** 2
    return hxx, hxy, hyy


@compiled
def _residuals(
    target: Image, x: float, y: float, w: Array, template: Array, weight: Array, px: Array,
    py: Array, m0: float,
) -> tuple[float, float, float]:
    """Right-hand side rx, ry of a patch at (x, y), and its squared difference, bilinear."""
    size, radius = px.shape[1], px.shape[1] // 2
    w00, w01, w10, w11 = w[0, 0], w[0, 1], w[1, 0], w[1, 1]
    mean, total, rx, ry = 0.0, 0.0, 0.0, 0.0
    for a in range(size):
        for b in range(size):
            da, db = a - radius, b - radius
            tx, ty = x + w00 * db + w01 * da, y + w10 * db + w11 * da
            ix, iy = int(tx), int(ty)
            fx, fy = tx - ix, ty - iy
            c00, c01 = (1 - fx) * (1 - fy), fx * (1 - fy)
            c10, c11 = (1 - fx) * fy, fx * fy
            share = weight[0, a, b]
            if share > 1e-3:
                e = template[0, a, b] - (
                    c00 * target[iy, ix, 0] + c01 * target[iy, ix + 1, 0]
                    + c10 * target[iy + 1, ix, 0] + c11 * target[iy + 1, ix + 1, 0])
                mean += share * e
                total += share * e * e
                rx += share * px[0, a, b] * e
                ry += share * py[0, a, b] * e
            share = weight[1, a, b]
            if share > 0.0:
                e = template[1, a, b] - (
                    c00 * target[iy, ix, 1] + c01 * target[iy, ix + 1, 1]
                    + c10 * target[iy + 1, ix, 1] + c11 * target[iy + 1, ix + 1, 1])
                total += share * e * e
                rx += share * px[1, a, b] * e
                ry += share * py[1, a, b] * e
    if m0 > 0:
        mean /= m0
        total -= m0 * mean * mean
    return rx, ry, total


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
