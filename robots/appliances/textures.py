"""Colours, seeded draws and palette images: integer arithmetic, equal on every machine."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .shapes import cosine, sine

_T = TypeVar("_T")

Color = tuple[int, int, int]
"""sRGB, 0..255"""


class SeededRng:
    """Draws from integers of a seeded generator, the same on every machine."""

    def __init__(self, generator: np.random.Generator) -> None:
        self.generator = generator

    def integer(self, low: int, high: int) -> int:
        """Draw an integer; both ends are included."""
        return int(self.generator.integers(low, high + 1))

    def length(self, low: float, high: float) -> float:
        """Draw a length in m, on a grid of 1 mm."""
        return self.integer(round(low * 1000), round(high * 1000)) / 1000

    def angle(self, low: float, high: float) -> float:
        """Draw an angle, on a grid of 0.001 rad."""
        return self.length(low, high)

    def chance(self, percent: int) -> bool:
        """Draw True with a probability in percent."""
        return self.integer(0, 99) < percent

    def choice(self, options: Sequence[_T], weights: Sequence[int] | None = None) -> _T:
        """Draw one of the options; the weights are integers."""
        chances = weights or [1] * len(options)
        drawn = self.integer(0, sum(chances) - 1)
        for option, weight in zip(options, chances, strict=True):
            drawn -= weight
            if drawn < 0:
                return option
        raise AssertionError("the weights are positive")

    def near(self, color: Color, spread: int) -> Color:
        """Draw a colour up to `spread` lighter or darker; its channels shift almost alike."""
        shift, tint = self.integer(-spread, spread), spread // 5
        r, g, b = (min(255, max(0, c + shift + self.integer(-tint, tint))) for c in color)
        return r, g, b


_GLYPHS = {
    "A": "7E1111117E", "B": "7F49494936", "C": "3E41414122", "D": "7F4141221C", "E": "7F49494941",
    "F": "7F09090901", "G": "3E4149497A", "H": "7F0808087F", "I": "00417F4100", "J": "2040413F01",
    "K": "7F08142241", "L": "7F40404040", "M": "7F020C027F", "N": "7F0408107F", "O": "3E4141413E",
    "P": "7F09090906", "Q": "3E4151215E", "R": "7F09192946", "S": "4649494931", "T": "01017F0101",
    "U": "3F4040403F", "V": "1F2040201F", "W": "3F4038403F", "X": "6314081463", "Y": "0708700807",
    "Z": "6151494543", "0": "3E5149453E", "1": "00427F4000", "2": "4261514946", "3": "2141454B31",
    "4": "1814127F10", "5": "2745454539", "6": "3C4A494930", "7": "0171090503", "8": "3649494936",
    "9": "064949291E", ":": "0036360000", " ": "0000000000", "+": "08083E0808",
    "-": "0808080808",
}
"""5 x 7 dots: one byte per column, the lowest bit on top."""


@dataclass(frozen=True)
class PaletteImage:
    """An image of at most 256 colours."""

    pixels: NDArray[np.uint8]
    """[h w] index into the palette, row 0 on top"""
    palette: tuple[Color, ...]


def encode_png(picture: PaletteImage) -> bytes:
    """Encode a PNG whose bytes depend on the pixels alone: stored, as compressors differ."""
    height, width = picture.pixels.shape
    lines = np.zeros((height, width + 1), np.uint8)  # filter 0 before each row
    lines[:, 1:] = picture.pixels
    raw = lines.tobytes()
    blocks = [raw[k : k + 65535] for k in range(0, len(raw), 65535)]
    stream = b"\x78\x01" + b"".join(
        struct.pack("<BHH", k == len(blocks) - 1, len(b), 0xFFFF ^ len(b)) + b
        for k, b in enumerate(blocks)
    ) + struct.pack(">I", zlib.adler32(raw))
    header = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    colors = bytes(value for color in picture.palette for value in color)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in ((b"IHDR", header), (b"PLTE", colors), (b"IDAT", stream), (b"IEND", b"")))


def text_image(
    text: str, ink: Color, paper: Color, scale: int = 4, margin: int = 1
) -> PaletteImage:
    """Return a line of capitals and digits; a dot and the unit of margins are `scale` px."""
    return PaletteImage(_text_dots(text, margin).repeat(scale, 0).repeat(scale, 1), (paper, ink))


def keypad_image(
    labels: Sequence[Sequence[str]], ink: Color, paper: Color, button: Color, round_: bool
) -> PaletteImage:
    """Return rows of buttons with words on them; rows may differ in their number of buttons."""
    cell, width = 24, 144
    out = np.zeros((cell * len(labels) + 4, width), np.uint8)
    for row, texts in enumerate(labels):
        step = width // len(texts)
        for column, text in enumerate(texts):
            top, left = row * cell + 4, column * step + 3
            high, wide = cell - 4, step - 6
            v, u = np.indices((high, wide))
            r = high // 2 if round_ else 3
            du = np.maximum(np.maximum(r - u, u - (wide - 1 - r)), 0)
            dv = np.maximum(np.maximum(r - v, v - (high - 1 - r)), 0)
            out[top : top + high, left : left + wide][du * du + dv * dv <= r * r] = 2
            dots = _text_dots(text, 0)
            scale = 2 if 2 * dots.shape[1] <= wide - 4 else 1
            dots = dots.repeat(scale, 0).repeat(scale, 1)[: high - 2, : wide - 2]
            y, x = top + (high - dots.shape[0]) // 2, left + (wide - dots.shape[1]) // 2
            out[y : y + dots.shape[0], x : x + dots.shape[1]][dots > 0] = 1
    return PaletteImage(out, (paper, ink, button))


def brushed_metal(
    rng: np.random.Generator, tone: Color, contrast: int, along_u: bool = True
) -> PaletteImage:
    """Return fine streaks, 128 x 128 px."""
    streak = rng.integers(-contrast, contrast + 1, (128, 1)) + rng.integers(-2, 3, (128, 128))
    for shift in (1, 2, 3, 5):  # grains are longer than a pixel
        streak[:, shift:] = (streak[:, shift:] * 3 + streak[:, :-shift]) // 4
    return PaletteImage(_levels(streak if along_u else streak.T), shades(tone))


def speckled_enamel(rng: np.random.Generator, tone: Color, contrast: int) -> PaletteImage:
    """Return fine dots, 128 x 128 px."""
    noise = rng.integers(-2, 3, (128, 128))
    dots = rng.integers(0, 128, (420, 2))
    noise[dots[:, 0], dots[:, 1]] += np.where(np.arange(420) % 2 > 0, 4 * contrast, -4 * contrast)
    return PaletteImage(_levels(noise), shades(tone))


def wood_grain(rng: np.random.Generator, tone: Color, contrast: int) -> PaletteImage:
    """Return vertical grain of veneer, 128 x 128 px, tileable from top to bottom."""
    out = np.zeros((128, 128), np.int64)
    u, v = np.arange(128), np.arange(128)[:, None]
    for period, weight in ((43, 4), (17, 3), (7, 2)):
        phase = int(rng.integers(0, period))
        shift, depth = int(rng.integers(0, 128)), int(rng.integers(1, 9))
        bend = np.abs((v * 2 + shift) % 128 - 64) * depth // 64
        place = (u[None] + bend + phase) % period
        out += weight * (np.abs(2 * place - period) * 2 - period) // period
    out += rng.integers(-1, 2, (1, 128))
    return PaletteImage(_levels(out * contrast // 4), shades(tone))


def dot_pattern(ink: Color, paper: Color) -> PaletteImage:
    """Return a tile of 16 holes of the screen in the window of a microwave."""
    v, u = np.indices((64, 64))
    near = (v % 16 - 8) ** 2 + (u % 16 - 8) ** 2 <= 18
    return PaletteImage(near.astype(np.uint8), (paper, ink))


def gauge_image(ink: Color, paper: Color, marks: int) -> PaletteImage:
    """Return marks around a knob over three quarters of a turn, 96 x 96 px."""
    out = np.zeros((96, 96), np.uint8)
    for k in range(marks):
        angle = 225.0 - 270.0 * k / (marks - 1)
        for r in range(38, 46 if k % 2 == 0 else 42):
            y, x = round(48 - r * float(sine(angle))), round(48 + r * float(cosine(angle)))
            out[y - 1 : y + 1, x - 1 : x + 1] = 1
    return PaletteImage(out, (paper, ink))


def shades(tone: Color) -> tuple[Color, ...]:
    """Return 64 colours from dark to light; number 32 is the tone."""
    def level(value: int, k: int) -> int:
        return min(255, value * (96 + k) // 128)

    return tuple((level(tone[0], k), level(tone[1], k), level(tone[2], k)) for k in range(64))


def _levels(values: NDArray[np.int64]) -> NDArray[np.uint8]:
    return np.clip(32 + values, 0, 63).astype(np.uint8)


def _text_dots(text: str, margin: int) -> NDArray[np.uint8]:
    """[h w] 1 where there is ink."""
    columns: list[int] = []
    for letter in text:
        columns += [*bytes.fromhex(_GLYPHS[letter]), 0]
    dots = np.array([[column >> row & 1 for column in columns[:-1]] for row in range(7)], np.uint8)
    return np.pad(dots, margin)
