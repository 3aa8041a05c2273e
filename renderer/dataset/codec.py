"""Encode images of the dataset as PNG bytes and decode them, as the dataset contract specifies.

CPU time with the conversion to integers, and size, of a 640x480 frame (means of 24 frames of ur5
and microwave before images and in rooms; tests/speed/codec_speed.py):

    image          gcbench            OpenCV's encoder
    RGB            4.7 ms, 283 KiB    6.6 ms, 289 KiB
    depth          1.2 ms,  67 KiB    2.4 ms,  74 KiB
    each flow      1.6 ms,  32 KiB    3.9 ms,  40 KiB
    part           0.1 ms,   3 KiB    0.3 ms,   2 KiB
    visibility     0.1 ms,   3 KiB    0.3 ms,   2 KiB
    all six        9.3 ms, 419 KiB   17.5 ms, 446 KiB
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError, RenderError
from . import codes
from .png_reader import read_png
from .png_writer import PngFilter, write_png


def encode_rgb(rgb: NDArray[np.uint8]) -> bytes:
    """Encode an sRGB image [H W 3]."""
    return write_png(_require_image(rgb, np.uint8, 3), PngFilter.MEAN)


def encode_depth(depth: NDArray[np.float32], unit: float = codes.DEPTH_UNIT) -> bytes:
    """Encode depth [H W] in m, rounded to units of `unit` m; 0 stays 0, "no surface".

    Raises RenderError if a depth is negative, not a number or deeper than 65535 units.
    """
    return write_png(codes.depth_codes(_require_image(depth, np.float32), unit), PngFilter.LEFT)


def encode_part(part: NDArray[np.uint16], wide: bool = False) -> bytes:
    """Encode part numbers [H W] with 8 bits per pixel, or 16 if `wide` (more than 255 parts).

    Raises RenderError if a number does not fit.
    """
    labels = _require_image(part, np.uint16)
    if not wide and labels.max(initial=0) > 255:
        raise RenderError(f"part number {labels.max()} does not fit an 8-bit part image")
    return write_png(labels if wide else labels.astype(np.uint8), PngFilter.NONE)


def widen_part(png: bytes) -> bytes:
    """Return the 16-bit version of an image of `encode_part`."""
    part = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    return write_png(np.asarray(part, np.uint16), PngFilter.NONE)


def encode_labels(labels: NDArray[np.uint8]) -> bytes:
    """Encode visibility or a mask [H W]."""
    return write_png(_require_image(labels, np.uint8), PngFilter.NONE)


def encode_flow(flow: NDArray[np.float32]) -> bytes:
    """Encode flow [H W 2] px as in KITTI: red u, green v, blue 1 where valid.

    NaN, and flow of 512 px or more, is (0, 0, 0).
    """
    return _write_field(codes.flow_codes(_require_image(flow, np.float32, 2)))


def encode_normal(normal: NDArray[np.float32]) -> bytes:
    """Encode unit normals [H W 3]: red x, green y, blue z as 1 + round((n + 1) / 2 * 65534).

    NaN is (0, 0, 0).
    """
    return _write_field(codes.normal_codes(_require_image(normal, np.float32, 3)))


def encode_coordinates(
    coordinates: NDArray[np.float32], part: NDArray[np.uint16], box: NDArray[np.float64]
) -> bytes:
    """Encode coordinates [H W 3] m as 1 + round(65534 * share); NaN is (0, 0, 0).

    `share` is the position in the box [P 2 3] m of each pixel's part number [H W].
    """
    shares = codes.shares_of_boxes(_require_image(coordinates, np.float32, 3), part, box)
    return _write_field(codes.share_codes(shares))


def decode_normal(png: bytes, size: tuple[int, int], where: str) -> NDArray[np.float32]:
    """Decode unit normals [H W 3]; NaN where there is no surface."""
    return codes.normal_of_codes(read_png(png, size, where, 3, 16))


def decode_shares(png: bytes, size: tuple[int, int], where: str) -> NDArray[np.float32]:
    """Decode coordinates [H W 3] as shares 0..1 of a box; NaN where there is no part."""
    return codes.shares_of_codes(read_png(png, size, where, 3, 16)).astype(np.float32)


def decode_rgb(png: bytes, size: tuple[int, int], where: str) -> NDArray[np.uint8]:
    """Decode sRGB [H W 3]. `size` is (width, height) px; `where` names file and member in errors.

    Raises DatasetError if the PNG is damaged or not of this size and kind (all decoders).
    """
    bgr = read_png(png, size, where, 3, 8)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)


def decode_depth(png: bytes, size: tuple[int, int], where: str, unit: float) -> NDArray[np.float32]:
    """Decode depth [H W] m; 0 where there is no surface. `unit` is m per unit of the PNG."""
    return codes.depth_of_codes(read_png(png, size, where, 1, 16), unit)


def decode_part(png: bytes, size: tuple[int, int], where: str, parts: int) -> NDArray[np.uint16]:
    """Decode part numbers [H W] in 0..parts. Raises DatasetError for a larger one."""
    raw = read_png(png, size, where, 1, 8 if parts <= 255 else 16)
    if raw.max(initial=0) > parts:
        raise DatasetError(f"{where}: part number {raw.max()}, but there are {parts} parts")
    return raw.astype(np.uint16)


def decode_visibility(png: bytes, size: tuple[int, int], where: str) -> NDArray[np.uint8]:
    """Decode visibility [H W] in 0..3."""
    raw = read_png(png, size, where, 1, 8)
    if raw.max(initial=0) > 3:
        raise DatasetError(f"{where}: visibility {raw.max()}, but only 0 to 3 have a meaning")
    return raw


def decode_flow(png: bytes, size: tuple[int, int], where: str) -> NDArray[np.float32]:
    """Decode flow [H W 2] px; NaN where invalid."""
    return codes.flow_of_codes(read_png(png, size, where, 3, 16))


def _require_image(image: NDArray[Any], dtype: type[np.generic], channels: int = 0) -> NDArray[Any]:
    """Return the image, contiguous. Raises ValueError for another shape or dtype."""
    shape_fits = image.ndim == 3 and image.shape[2] == channels if channels else image.ndim == 2
    if image.dtype != dtype or not shape_fits:
        raise ValueError(f"{image.dtype} image of shape {image.shape}; expected {dtype.__name__}")
    return np.ascontiguousarray(image)


def _write_field(bgr: NDArray[np.uint16]) -> bytes:
    return write_png(np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)), PngFilter.UP)
