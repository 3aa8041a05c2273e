"""Procedural images for surfaces and backgrounds.

Every kind has grain on all scales, because optical flow needs a gradient everywhere, also inside
the cells of a checkerboard. All fields are random grids that `cv2.resize` enlarges octave by
octave; the total cost is close to that of the last enlargement.
"""

from __future__ import annotations

from collections.abc import Callable
from math import gcd

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError

TextureImage = NDArray[np.uint8]
PLAIN = "plain"
"""The kind of a background of one color."""
Field = NDArray[np.float32]
_TABLE = 1024  # entries of one period of a colour table


def draw_texture(kind: str, size: tuple[int, int], rng: np.random.Generator,
                 tileable: bool) -> TextureImage:
    """Draw an sRGB image [h w 3] of `size` (h, w) px; a tileable one repeats without a seam.

    Raises ConfigError for a kind that is not in KINDS.
    """
    if kind not in KINDS:
        raise ConfigError(f"no texture kind {kind!r}: choose from {', '.join(KINDS)}")
    return KINDS[kind](size, rng, tileable)


def _enlarge(grid: Field, size: tuple[int, int], tileable: bool) -> Field:
    """Return `grid` [gh gw c] enlarged to `size` (h, w) by cubic interpolation."""
    (gh, gw), (h, w) = grid.shape[:2], size
    if not tileable:
        return _resize(grid, h, w)
    # Pad by a number of cells that is a whole number of pixels: at least the two of the kernel.
    py, px = gh // gcd(gh, h), gw // gcd(gw, w)
    py, px = py * -(-2 // py), px * -(-2 // px)
    y, x = py * h // gh, px * w // gw
    wrapped = np.pad(grid, ((py, py), (px, px), (0, 0)), mode="wrap")
    return _resize(wrapped, h + 2 * y, w + 2 * x)[y:y + h, x:x + w]


def _resize(grid: Field, h: int, w: int) -> Field:
    large = cv2.resize(grid, (w, h), interpolation=cv2.INTER_CUBIC)
    return np.asarray(large, np.float32).reshape(h, w, -1)


def _octaves(size: tuple[int, int], cells: tuple[int, int], rng: np.random.Generator,
             tileable: bool, channels: int = 1, persistence: float = 0.6) -> Field:
    """Draw noise [h w c], mean 0, deviation about 1, from `cells` (rows, columns) to ~2-4 px.

    `persistence` is the amplitude of each octave relative to the next coarser one.
    """
    (h, w), (gh, gw) = size, cells
    field = rng.random((gh, gw, channels), np.float32) - 0.5
    strength = 1.0
    while 4 * gh <= h and 4 * gw <= w:
        gh, gw, strength = 2 * gh, 2 * gw, strength * persistence
        finer = rng.random((gh, gw, channels), np.float32) - 0.5
        field = _enlarge(field, (gh, gw), tileable) + np.float32(strength) * finer
    field = (field - field.mean()) / (field.std() + 1e-6)
    return _enlarge(field, size, tileable)


def _colors(n: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw sRGB colours [n 3] in 0..255, alternately dark and light, never black or white."""
    dark = (np.arange(n) + rng.integers(2)) % 2 == 0
    value = np.where(dark, rng.uniform(0.22, 0.48, n), rng.uniform(0.6, 0.85, n))
    hsv = np.stack([rng.uniform(0, 360, n), rng.uniform(0.05, 0.6, n), value], -1)
    rgb = cv2.cvtColor(hsv[None].astype(np.float32), cv2.COLOR_HSV2RGB)
    return np.asarray(rgb[0] * 255, np.float32)


def _add_grain(image: TextureImage, rng: np.random.Generator, tileable: bool,
             cells: tuple[int, int] = (8, 8), strength: float = 9.0) -> TextureImage:
    """Add brightness noise of about `strength` grey levels to an image."""
    noise = _octaves((image.shape[0], image.shape[1]), cells, rng, tileable, persistence=0.85)
    grain = cv2.convertScaleAbs(noise, alpha=strength, beta=128)  # 128 means no change
    return np.asarray(cv2.addWeighted(image, 1, cv2.merge([grain] * 3), 1, -128), np.uint8)


def _noise(size: tuple[int, int], rng: np.random.Generator, tileable: bool) -> TextureImage:
    n = int(rng.integers(2, 7))
    field = _octaves(size, (n, n), rng, tileable, 3, persistence=rng.uniform(0.6, 0.9))
    # Channels vary mostly together: independent channels would give saturated colour noise.
    mix = rng.uniform(15, 40) * (0.8 + rng.uniform(-0.5, 0.5, (3, 3)) * [1, 0.6, 0.6])
    mix[:, 1:] *= 0.4
    base = rng.uniform(80, 175, (3, 1))
    color = cv2.transform(field, np.hstack([mix, base]).astype(np.float32))
    # Clip to 16..239 before the grain is added: saturated areas would be flat.
    image = np.clip(color, 16, 239).astype(np.uint8)
    return _add_grain(image, rng, tileable, strength=6)


def _checker(size: tuple[int, int], rng: np.random.Generator, tileable: bool) -> TextureImage:
    n = 2 * int(rng.integers(1, 5))
    even = np.add.outer(np.arange(n), np.arange(n)) % 2
    cells = _colors(2, rng)[even] + rng.uniform(-18, 18, (n, n, 1))
    image = cv2.resize(cells.astype(np.uint8), size[::-1], interpolation=cv2.INTER_NEAREST)
    return _add_grain(np.asarray(image, np.uint8), rng, tileable)


def _stripes(size: tuple[int, int], rng: np.random.Generator, tileable: bool) -> TextureImage:
    h, w = size
    n = int(rng.integers(2, 7))
    edges = np.cumsum(rng.uniform(0.25, 1.0, n))
    stripe = np.searchsorted(edges / edges[-1], np.arange(_TABLE) / _TABLE, side="right")
    table = _colors(n, rng)[stripe]
    table = np.mean([np.roll(table, shift, 0) for shift in range(-2, 3)], 0).astype(np.uint8)
    # Whole numbers of periods along both sides: stripes of any direction that still tile.
    angle, cycles = rng.uniform(0, np.pi), rng.uniform(1, 4)
    along_x = round(cycles * np.cos(angle) * w / min(h, w))
    along_y = round(cycles * np.sin(angle) * h / min(h, w)) or int(along_x == 0)
    x, y = np.arange(w) * along_x * _TABLE // w, np.arange(h) * along_y * _TABLE // h
    index = (y[:, None] + x[None]) % _TABLE
    return _add_grain(np.take(table, index, 0), rng, tileable, strength=11)


def _wood(size: tuple[int, int], rng: np.random.Generator, tileable: bool) -> TextureImage:
    lying = rng.random() < 0.5
    h, w = size if lying else size[::-1]
    planks = int(rng.integers(1, 6))
    plank = np.arange(h) * planks // h
    tone = np.array([rng.uniform(110, 205), rng.uniform(0.6, 0.8), rng.uniform(0.55, 0.85)])
    light = np.array([tone[0], tone[0] * tone[1], tone[0] * tone[1] * tone[2]])
    # An annual ring darkens gradually and ends abruptly; each plank has its own brightness.
    ring = 1 - rng.uniform(0.2, 0.45) * np.linspace(0, 1, _TABLE) ** 2
    tables = np.outer(rng.uniform(0.8, 1.15, planks), ring)[..., None] * light
    wobble = _octaves((h, w), (4, 1), rng, tileable, persistence=0.4)[..., 0]
    rings = rng.integers(4, 12) * np.arange(h) / h + rng.uniform(0, 1, planks)[plank]
    phase = (rings[:, None].astype(np.float32) + wobble * np.float32(rng.uniform(0.4, 1.2)) + 64)
    index = (phase * _TABLE).astype(np.int32) % _TABLE + (plank * _TABLE)[:, None].astype(np.int32)
    image = np.take(tables.reshape(-1, 3).clip(0, 255).astype(np.uint8), index, 0)
    for joint in np.flatnonzero(np.diff(plank, prepend=-1)) if planks > 1 else ():
        image[joint:joint + max(1, h // 200)] //= 2
    image = _add_grain(image, rng, tileable, cells=(max(h // 8, 1), 8), strength=8)
    return image if lying else np.ascontiguousarray(image.swapaxes(0, 1))


def _clutter(size: tuple[int, int], rng: np.random.Generator, tileable: bool) -> TextureImage:
    h, w = size
    image = _noise(size, rng, tileable)
    n = 90
    colors = _colors(n, rng).tolist()
    copies = [(x, y) for x in (-w, 0, w) for y in (-h, 0, h)] if tileable else [(0, 0)]
    for i in range(n):  # large shapes first, small ones on top
        radius = min(h, w) * (0.03 + 0.3 * (1 - i / n) ** 2)
        turn = rng.normal(0, 0.1) if rng.random() < 0.7 else rng.uniform(0, np.pi)
        c, s = np.cos(turn), np.sin(turn)
        at = rng.uniform(0, [w, h])
        shapes = _shapes(radius, rng)
        for k, shape in enumerate(shapes):
            points = shape @ [[c, s], [-s, c]] + at
            color = colors[(i * (1 if len(shapes) == 1 else 7) + k) % n]
            for copy in copies:
                cv2.fillPoly(image, [np.rint((points + copy) * 16).astype(np.int32)], color,
                             cv2.LINE_AA, shift=4)
    return _add_grain(image, rng, tileable, strength=10)


def _shapes(radius: float, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Draw outlines [n 2] px about the origin: a box, disc, polygon, line or row of boxes."""
    box = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    kind = rng.choice(5, p=[0.3, 0.2, 0.15, 0.15, 0.2])
    if kind == 0:
        return [box * radius * rng.uniform(0.4, 1.2, 2)]
    if kind in (1, 2):
        angle = np.linspace(0, 2 * np.pi, 28 if kind == 1 else int(rng.integers(3, 8)), False)
        circle = np.stack([np.cos(angle), np.sin(angle)], -1) * rng.uniform(0.4, 1.2, 2)
        return [radius * circle * (1 if kind == 1 else rng.uniform(0.5, 1.2, (len(angle), 1)))]
    if kind == 3:
        return [box * [3 * radius, max(1.0, 0.04 * radius)]]
    edges = np.cumsum(rng.uniform(0.12, 0.35, 10)) * radius
    tops = radius * rng.uniform(0.6, 1.0, 9)
    return [np.array([[a, 0], [b, 0], [b, -t], [a, -t]])
            for a, b, t in zip(edges[:-1], edges[1:], tops, strict=True)]


KINDS: dict[str, Callable[[tuple[int, int], np.random.Generator, bool], TextureImage]] = {
    "noise": _noise, "checker": _checker, "stripes": _stripes, "wood": _wood, "clutter": _clutter,
}
