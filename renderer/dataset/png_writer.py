"""Write PNG files: a fixed filter for all rows, computed by NumPy, and zlib-ng's compression.

The files are ordinary PNGs of one IDAT chunk. On the same machine, equal images are equal bytes;
zlib-ng has other code for other processors, which may compress otherwise. (ISA-L is twice as fast,
but its output depends on what the process did before.)
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from zlib_ng import zlib_ng

_LEVEL = 2  # 1 makes files half as large again; 3 takes 20 % more time


class PngFilter(IntEnum):
    """What is subtracted from each byte: the same byte of other pixels. Numbers as in PNG."""

    NONE = 0
    LEFT = 1
    UP = 2
    MEAN = 3
    """Of left and up, rounded down."""


def write_png(image: NDArray[Any], kind: PngFilter) -> bytes:
    """Return the PNG of an image [H W] or [H W 3] (RGB) of uint8 or uint16."""
    height, width = image.shape[:2]
    color, bits = 2 if image.ndim == 3 else 0, 8 * image.itemsize
    header = struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, 0)
    packed = zlib_ng.compress(_filter(image, kind).data, _LEVEL)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        _chunk(name, data) for name, data in ((b"IHDR", header), (b"IDAT", packed), (b"IEND", b"")))


def _filter(image: NDArray[Any], kind: PngFilter) -> NDArray[np.uint8]:
    """[H 1+N] the number of the filter and the N filtered bytes of each row."""
    height, width = image.shape[:2]
    step = image.nbytes // (height * width)  # bytes of a pixel
    # Pixels beyond the left and upper border are 0.
    padded = np.zeros((height + 1, (width + 1) * step), np.uint8)
    rows, left, up = padded[1:, step:], padded[1:, :-step], padded[:-1, step:]
    rows.view(image.dtype.newbyteorder(">"))[:] = image.reshape(height, -1)
    out = np.empty((height, 1 + width * step), np.uint8)
    out[:, 0] = kind
    if kind == PngFilter.NONE:
        out[:, 1:] = rows
    elif kind == PngFilter.MEAN:
        half = (left ^ up) >> 1
        half += left & up  # the mean of bytes, without a carry
        np.subtract(rows, half, out=out[:, 1:])
    else:
        np.subtract(rows, left if kind == PngFilter.LEFT else up, out=out[:, 1:])
    return out


def _chunk(name: bytes, data: bytes) -> bytes:
    checksum = zlib_ng.crc32(data, zlib_ng.crc32(name))
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", checksum)
