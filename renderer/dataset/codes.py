"""Integers that images of the dataset are stored as, as the dataset contract specifies, and back.

Images of three channels are in OpenCV's order (BGR).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import RenderError

DEPTH_UNIT = 0.0001
"""m per unit of the depth PNG; a sequence may define another (`Meta.depth_unit`)."""

_FLOW_SCALE, _FLOW_ZERO = 64, 32768


def depth_codes(depth: NDArray[np.float32], unit: float) -> NDArray[np.uint16]:
    """Return depth [H W] m, rounded to units of `unit` m; 0 stays 0, "no surface".

    Raises RenderError if a depth is negative, not a number or deeper than 65535 units.
    """
    units = np.rint(depth * np.float32(1.0 / unit))
    if not (units.min(initial=0) >= 0 and units.max(initial=0) <= 65535):
        raise RenderError(
            f"depth from {depth.min():g} to {depth.max():g} m does not fit a depth image of "
            f"0..{65535 * unit:g} m; choose a larger depth_unit than {unit:g} m"
        )
    return units.astype(np.uint16)


def depth_of_codes(raw: NDArray[Any], unit: float) -> NDArray[np.float32]:
    """Return depth [H W] m of `depth_codes`."""
    return np.multiply(raw, np.float32(unit), dtype=np.float32)


def flow_codes(flow: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return flow [H W 2] px as in KITTI: red u, green v, blue 1 where valid.

    NaN, and flow of 512 px or more, is (0, 0, 0).
    """
    with np.errstate(invalid="ignore"):  # NaN and inf become integers, masked below
        units = np.rint(flow * np.float32(_FLOW_SCALE))
        fits = cv2.inRange(units, (-32767, -32767), (32767, 32767))
        # 2^15 added modulo 2^16; via int32, which defines the result for negative numbers.
        coded = units.astype(np.int32).astype(np.uint16) ^ np.uint16(_FLOW_ZERO)
    u, v = cv2.split(coded)
    valid = np.minimum(fits, 1).astype(np.uint16)
    bgr = cv2.merge([valid, v * valid, u * valid])  # masking three channels at once takes 8 ms
    return np.asarray(bgr, np.uint16)


def flow_of_codes(bgr: NDArray[Any]) -> NDArray[np.float32]:
    """Return flow [H W 2] px of `flow_codes`; NaN where invalid."""
    valid, v, u = cv2.split(bgr)
    unknown = np.where(np.equal(valid, 0), np.float32(np.nan), np.float32(0.0))
    flow: list[NDArray[np.float32]] = []
    for code in (u, v):  # faster than both at once
        flow.append(np.asarray(code, np.float32))
        flow[-1] -= _FLOW_ZERO
        flow[-1] /= _FLOW_SCALE
        flow[-1] += unknown
    return np.asarray(cv2.merge(flow), np.float32)


def normal_codes(normal: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return unit normals [H W 3] as `share_codes` of (n + 1) / 2."""
    return share_codes((normal + 1.0) / 2.0)


def normal_of_codes(bgr: NDArray[Any]) -> NDArray[np.float32]:
    """Return unit normals [H W 3] of `normal_codes`; NaN where there is no surface."""
    return (shares_of_codes(bgr) * 2.0 - 1.0).astype(np.float32)


def share_codes(share: NDArray[Any]) -> NDArray[np.uint16]:
    """Return codes 1..65535 of values [H W 3] in 0..1 (clipped); 0 where one of three is NaN."""
    known = np.isfinite(share).all(axis=2, keepdims=True)
    units = np.rint(np.clip(np.where(known, share, 0.0), 0.0, 1.0) * 65534.0) + 1.0
    return np.where(known, units, 0.0)[..., ::-1].astype(np.uint16)


def shares_of_codes(bgr: NDArray[Any]) -> NDArray[np.float64]:
    """Return values [H W 3] in 0..1 of `share_codes`; NaN where a code is 0."""
    code = bgr[..., ::-1].astype(np.float64)
    return np.where((code > 0).all(axis=2, keepdims=True), (code - 1.0) / 65534.0, np.nan)


def shares_of_boxes(
    coordinates: NDArray[np.floating], part: NDArray[np.unsignedinteger], box: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return coordinates [H W 3] m as shares of the boxes [P 2 3] m of parts [H W]."""
    low, size = _box_of(part, box)
    return (coordinates - low) / np.where(size > 0, size, 1.0)


def coordinates_in_boxes(
    share: NDArray[np.float32], part: NDArray[np.uint16], box: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return coordinates [H W 3] m: shares [H W 3] of the boxes [P 2 3] m of parts [H W]."""
    low, size = _box_of(part, box)
    return (low + share * size).astype(np.float32)


def _box_of(
    part: NDArray[np.unsignedinteger], box: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lower corner and size [H W 3] m of the box of each pixel's part; background: 0."""
    boxes = np.concatenate([np.zeros((1, 2, 3)), box])[part]
    return boxes[..., 0, :], boxes[..., 1, :] - boxes[..., 0, :]
