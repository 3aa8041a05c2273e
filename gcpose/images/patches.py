"""Patches of a key frame found again in other frames, where a hypothesis expects them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import Image, compiled

_GAIN, _FLOOR = 8.0, 30.0  # of a pixel's variance: of what is left of a patch, and squared levels


@compiled
def match(
    images: Image, pixel: Array, frame: NDArray[np.int64], place: Array, warp: Array,
    wanted: NDArray[np.bool_], radius: int, reach: float, model: float, model_rate: float,
    contrast: float, even: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Where the patches around pixels [N 2] of key frames [N] are in the frames `wanted` [N T].

    images [T H W 2]: brightness, whose offset is free, and an outline of `contrast`, which tells
    only what happens across it: along it, a round body's outline does not move with the body.
    Each patch is expected at place [N T 2], distorted by warp [N T 2 2], and looked for within
    `reach` px by Gauss-Newton. Returns the places found and their information [N T 2 2] in 1/px2,
    0 where nothing was: limited by what the patch's shape errs by (`model` px and `model_rate` for
    each frame between), and less where gradients are under `even` grey levels a pixel (shading).
    """
    n, frames = wanted.shape
    height, width = images.shape[1:3]
    found = place.copy()
    info = np.zeros((n, frames, 2, 2))
    size = 2 * radius + 1
    tmpl = np.zeros((2, size, size))
    gx = np.zeros((2, size, size))
    gy = np.zeros((2, size, size))
    px = np.zeros((2, size, size))
    py = np.zeros((2, size, size))
    window = np.zeros((size, size))
    weight = np.zeros((2, size, size))
    for a in range(size):
        for b in range(size):
            window[a, b] = np.exp(-((a - radius) ** 2 + (b - radius) ** 2) / (radius * radius))
    for i in range(n):
        u, v = int(np.rint(pixel[i, 0])), int(np.rint(pixel[i, 1]))
        if min(u, v) < radius + 1 or u >= width - radius - 1 or v >= height - radius - 1:
            continue
        source = images[frame[i]]
        m0 = 0.0
        m1 = 0.0
        for a in range(size):
            for b in range(size):
                y, x = v + a - radius, u + b - radius
                for c in range(2):
                    tmpl[c, a, b] = source[y, x, c]
                    gx[c, a, b] = 0.5 * (source[y, x + 1, c] - source[y, x - 1, c])
                    gy[c, a, b] = 0.5 * (source[y + 1, x, c] - source[y - 1, x, c])
                inside = min(1.0, tmpl[1, a, b] / contrast)
                weight[0, a, b] = window[a, b] * inside ** 6
                weight[1, a, b] = window[a, b]
                m0 += weight[0, a, b]
                m1 += weight[1, a, b]
        for t in range(frames):
            if not wanted[i, t]:
                continue
            w00, w01 = warp[i, t, 0, 0], warp[i, t, 0, 1]
            w10, w11 = warp[i, t, 1, 0], warp[i, t, 1, 1]
            det = w00 * w11 - w01 * w10
            if det < 0.3 or det > 3.0:
                continue
            # gradients in the target: warp^-T g
            i00, i01, i10, i11 = w11 / det, -w10 / det, -w01 / det, w00 / det
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
            # an outline tells only what happens across it
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
                        w = weight[c, a, b]
                        hxx += w * px[c, a, b] ** 2
                        hxy += w * px[c, a, b] * py[c, a, b]
                        hyy += w * py[c, a, b] ** 2
            ridge = 1e-2 * (hxx + hyy) + 20.0
            dxx, dyy = hxx + ridge, hyy + ridge
            dd = dxx * dyy - hxy * hxy
            x0, y0 = place[i, t, 0], place[i, t, 1]
            x, y = x0, y0
            target = images[t]
            ok = True
            total = 0.0
            for _ in range(10):
                rim = 1 + radius * (abs(w00) + abs(w01) + abs(w10) + abs(w11))
                if not (rim < x < width - rim - 1 and rim < y < height - rim - 1):
                    ok = False
                    break
                mean, total, rx, ry = 0.0, 0.0, 0.0, 0.0
                for a in range(size):
                    for b in range(size):
                        da, db = a - radius, b - radius
                        tx, ty = x + w00 * db + w01 * da, y + w10 * db + w11 * da
                        ix, iy = int(tx), int(ty)
                        fx, fy = tx - ix, ty - iy
                        c00, c01 = (1 - fx) * (1 - fy), fx * (1 - fy)
                        c10, c11 = (1 - fx) * fy, fx * fy
                        w = weight[0, a, b]
                        if w > 1e-3:
                            e = tmpl[0, a, b] - (
                                c00 * target[iy, ix, 0] + c01 * target[iy, ix + 1, 0]
                                + c10 * target[iy + 1, ix, 0] + c11 * target[iy + 1, ix + 1, 0])
                            mean += w * e
                            total += w * e * e
                            rx += w * px[0, a, b] * e
                            ry += w * py[0, a, b] * e
                        w = weight[1, a, b]
                        e = tmpl[1, a, b] - (
                            c00 * target[iy, ix, 1] + c01 * target[iy, ix + 1, 1]
                            + c10 * target[iy + 1, ix, 1] + c11 * target[iy + 1, ix + 1, 1])
                        total += w * e * e
                        rx += w * px[1, a, b] * e
                        ry += w * py[1, a, b] * e
                if m0 > 0:
                    mean /= m0
                    total -= m0 * mean * mean
                sx, sy = (dyy * rx - hxy * ry) / dd, (dxx * ry - hxy * rx) / dd
                size_of = np.sqrt(sx * sx + sy * sy)
                if size_of > 1.5:
                    sx, sy = sx * 1.5 / size_of, sy * 1.5 / size_of
                x, y = x + sx, y + sy
                if (x - x0) ** 2 + (y - y0) ** 2 > reach * reach:
                    ok = False
                    break
                if size_of < 0.02:
                    break
            if not ok:
                continue
            total /= m0 + m1
            found[i, t, 0], found[i, t, 1] = x, y
            variance = _GAIN * total + _FLOOR
            a00, a01, a11 = hxx / variance, hxy / variance, hyy / variance
            m = (model + model_rate * abs(t - frame[i])) ** 2
            # (A^-1 + m I)^-1 = A (I + m A)^-1
            b00, b01, b11 = 1 + m * a00, m * a01, 1 + m * a11
            bd = b00 * b11 - b01 * b01
            energy = (hxx + hyy) / m1
            trust = energy / (energy + even * even)
            trust *= trust
            info[i, t, 0, 0] = trust * (a00 * b11 - a01 * b01) / bd
            info[i, t, 0, 1] = trust * (-a00 * b01 + a01 * b00) / bd
            info[i, t, 1, 0] = info[i, t, 0, 1]
            info[i, t, 1, 1] = trust * (-a01 * b01 + a11 * b00) / bd
    return found, info
