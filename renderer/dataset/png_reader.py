"""Read PNG files strictly.

OpenCV converts a palette, 1-bit or animated PNG silently to the expected shape, prints errors of a
damaged one to stderr, and allocates the size that the header states. Therefore header and
checksums are verified here first. Images that `write_png` made with a simple filter are decoded
here, in half of OpenCV's time.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from ...errors import DatasetError
from ..types import MAX_PIXELS
from .png_writer import PngFilter

_CHANNELS = {0: 1, 2: 3}  # by PNG colour type
_SIMPLE = [bytes([kind]) for kind in (PngFilter.NONE, PngFilter.LEFT, PngFilter.UP)]


def read_png(
    png: bytes, size: tuple[int, int], where: str, channels: int, bits: int
) -> NDArray[Any]:
    """Return the pixels of a grey (1 channel) or RGB image (3), in OpenCV's order (BGR).

    `size` is (width, height) px; `where` names file and member in errors.

    Raises DatasetError if the PNG is damaged or not of this size and kind.
    """
    png, (width, height, depth, color), packed = _parse_png(png, where)
    if (width, height) != size or width * height > MAX_PIXELS:
        raise DatasetError(f"{where}: {width}x{height} px, expected {size[0]}x{size[1]}")
    if (_CHANNELS.get(color), depth) != (channels, bits):
        expected = {n: c for c, n in _CHANNELS.items()}[channels]
        raise DatasetError(f"{where}: PNG of colour type {color} with {depth} bits, "
                           f"expected colour type {expected} with {bits} bits")
    image = _unpack(packed, (height, width, channels), bits // 8)
    if image is None:
        try:
            image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            image = None
    shape = (height, width) if channels == 1 else (height, width, 3)
    if image is None or image.shape != shape or image.dtype.itemsize * 8 != bits:
        raise DatasetError(f"{where}: damaged PNG")
    return image


def _unpack(packed: bytes, shape: tuple[int, int, int], item: int) -> NDArray[Any] | None:
    """The pixels of compressed rows; None if they need OpenCV, which also judges damaged ones.

    `shape` is (height, width, channels), `item` the bytes of a value.
    """
    height, width, channels = shape
    length = height * (1 + width * channels * item)
    inflater = zlib_ng.decompressobj()
    try:
        first = inflater.decompress(packed, 1)
        if first not in _SIMPLE:
            return None
        data = first + inflater.decompress(inflater.unconsumed_tail, length)
    except zlib_ng.error:  # pyright: ignore[reportGeneralTypeIssues] # it is a class
        return None
    if not inflater.eof or len(data) != length:
        return None
    rows, kind = np.frombuffer(data, np.uint8).reshape(height, -1), first[0]
    if (rows[:, 0] != kind).any():
        return None
    out = np.array(rows[:, 1:])
    if kind == PngFilter.UP:
        for y in range(1, height):  # ten times as fast as np.add.accumulate
            np.add(out[y], out[y - 1], out=out[y])
    elif kind == PngFilter.LEFT:
        pixels = out.reshape(height, width, -1)
        np.add.accumulate(pixels, axis=1, dtype=np.uint8, out=pixels)
    values = out.view(f">u{item}").reshape(height, width, channels).astype(f"u{item}", copy=False)
    return values[..., 0] if channels == 1 else np.asarray(cv2.cvtColor(values, cv2.COLOR_RGB2BGR))


def _parse_png(png: bytes, where: str) -> tuple[bytes, tuple[int, int, int, int], bytes]:
    """Return a PNG without the chunks that do not concern its pixels, its header, and its data.

    The header is (width, height, bits, colour type). All chunks are complete and intact, and the
    compressed data begins as zlib's: libpng would print its complaints.
    """
    if png[:8] != b"\x89PNG\r\n\x1a\n":
        raise DatasetError(f"{where}: not a PNG")
    at, kept, parts = 8, [png[:8]], list[bytes]()
    while at + 12 <= len(png):
        length, kind = struct.unpack_from(">I4s", png, at)
        end = at + 12 + length
        chunk = png[at:end]
        if len(chunk) < 12 + length or chunk[-4:] != struct.pack(">I", zlib.crc32(chunk[4:-4])):
            break
        if (len(kept) == 1) != (kind == b"IHDR" and length == 13):
            break
        if kind == b"acTL":
            raise DatasetError(f"{where}: an animated PNG")
        if kind in (b"IHDR", b"IDAT", b"IEND"):
            kept.append(chunk)
        if kind == b"IDAT":
            parts.append(chunk[8:-4])
        if kind == b"IEND" and end == len(png):
            packed = b"".join(parts)
            width, height, bits, color, *methods = struct.unpack(">IIBBBBB", kept[1][8:-4])
            if methods != [0, 0, 0] or len(packed) < 2 or packed[0] & 0x8F != 8 \
                    or int.from_bytes(packed[:2], "big") % 31:
                break
            return b"".join(kept), (width, height, bits, color), packed
        at = end
    raise DatasetError(f"{where}: damaged PNG")
