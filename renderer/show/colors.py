"""Colour images of everything in a frame that is not a photograph.

Each function takes data and returns 8-bit RGB. Colours mean the same in every picture: a part has
the colour of its joint's axis and curve, and NO_VALUE always means that there is no value.
"""

from __future__ import annotations

import colorsys
import itertools
from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..dataset import codes
from ..types import BACKGROUND, OCCLUDED, OUT_OF_IMAGE, VISIBLE

RgbImage = NDArray[np.uint8]
NO_VALUE = (38, 40, 46)
"""No surface, no part, no flow: dark, because white is the colour of zero flow."""
VISIBILITY = {
    BACKGROUND: ("background", NO_VALUE),
    VISIBLE: ("visible at t+1", (0, 158, 115)),
    OCCLUDED: ("occluded at t+1", (230, 120, 20)),
    OUT_OF_IMAGE: ("out of the image at t+1", (86, 170, 240)),
}
"""Value of a visibility image -> what it says, RGB."""
_FIRST = ((66, 133, 220), (240, 128, 30), (46, 160, 80), (214, 64, 72), (150, 100, 200),
          (226, 176, 20), (30, 176, 190), (224, 110, 178), (140, 96, 72), (150, 176, 40),
          (110, 120, 240), (0, 120, 110))
"""Parts 1..12: readable on white and on black."""


@cache
def _palette(parts: int) -> bytes:
    import cv2

    def lab(rgb: NDArray[np.float64]) -> NDArray[np.float32]:
        image = (rgb[None] / 255.0).astype(np.float32)
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2Lab)[0], np.float32)

    first = np.array(_FIRST, np.float64)
    steps = itertools.product(range(48), (0.4, 0.6, 0.8, 1.0), (0.55, 0.7, 0.85, 1.0))
    grid = np.array([colorsys.hsv_to_rgb(h / 48, s, v) for h, s, v in steps]) * 255
    colors = list(first[:parts])
    if parts > len(first):
        candidates = lab(grid)
        known = np.concatenate([lab(first), lab(np.array([NO_VALUE], np.float64))])
        gap = np.linalg.norm(candidates[:, None] - known, axis=-1).min(axis=1)
        for _ in range(min(parts - len(first), len(grid))):
            best = int(gap.argmax())  # always the colour that is farthest from all that are taken
            colors.append(grid[best])
            gap = np.minimum(gap, np.linalg.norm(candidates - candidates[best], axis=-1))
    table = np.rint(np.array(colors).reshape(-1, 3)).astype(np.uint8)
    return np.resize(table, (parts, 3)).tobytes()  # beyond 780 parts colours repeat


def palette(parts: int) -> RgbImage:
    """RGB [parts+1 3]: row k is the colour of part k, row 0 that of the background.

    The first colours do not depend on how many parts there are.
    """
    rows = np.frombuffer(_palette(parts), np.uint8).reshape(-1, 3)
    return np.concatenate([np.array([NO_VALUE], np.uint8), rows])


def css(color: Iterable[int]) -> str:
    """Return a colour as `#rrggbb`."""
    return "#" + "".join(f"{int(c):02x}" for c in color)


def color_parts(part: NDArray[np.unsignedinteger], parts: int) -> RgbImage:
    """RGB [H W 3] of a part mask [H W] of a model with `parts` parts."""
    return palette(parts)[np.minimum(part, parts)]


def color_visibility(visibility: NDArray[np.uint8]) -> RgbImage:
    """RGB [H W 3] of a visibility image [H W]."""
    table = np.array([color for _, color in VISIBILITY.values()], np.uint8)
    return table[np.minimum(visibility, len(table) - 1)]


def color_normals(normal: NDArray[np.floating]) -> RgbImage:
    """RGB [H W 3] of unit normals [H W 3] in the camera frame: red points right, green up, blue
    towards the camera; NaN is NO_VALUE.
    """
    known = np.asarray(np.isfinite(normal).all(axis=-1))
    colors = np.rint((np.nan_to_num(normal) * [1.0, -1.0, -1.0] + 1.0) * 127.5).astype(np.uint8)
    colors[~known] = NO_VALUE
    return colors


def color_coordinates(
    coordinates: NDArray[np.floating], part: NDArray[np.unsignedinteger], box: NDArray[np.float64]
) -> RgbImage:
    """RGB [H W 3] of coordinates [H W 3] m on parts [H W]: each axis from 0 to full over the box
    [P 2 3] m of the part; NaN is NO_VALUE.
    """
    share = np.nan_to_num(codes.shares_of_boxes(coordinates, part, box))
    colors = np.rint(np.clip(share, 0.0, 1.0) * 255).astype(np.uint8)
    colors[~np.isfinite(coordinates).all(axis=-1)] = NO_VALUE
    return colors


def depth_colors() -> RgbImage:
    """RGB [256 3], far to near."""
    import cv2

    ramp = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)
    return np.ascontiguousarray(np.asarray(ramp, np.uint8)[:, 0, ::-1])


def color_depth(depth: NDArray[np.floating], near: float, far: float) -> RgbImage:
    """RGB [H W 3] of a depth image [H W] m; `near` and what is nearer is red, `far` is blue.

    Linear in 1/z, as disparity is: the robot keeps most of the colours, also before a distant room.
    """
    valid = np.asarray(np.isfinite(depth) & (depth > 0))
    z = np.clip(np.where(valid, depth, far), near, far)
    share = (1.0 / z - 1.0 / far) / max(1.0 / near - 1.0 / far, 1e-12)
    out = depth_colors()[np.rint(share * 255).astype(np.intp)]
    out[~valid] = NO_VALUE
    return out


@cache
def _wheel() -> bytes:
    # Baker et al., "A Database and Evaluation Methodology for Optical Flow": the number of steps
    # between two neighbors is proportional to how different they look.
    steps = (("RY", 15), ("YG", 6), ("GC", 4), ("CB", 11), ("BM", 13), ("MR", 6))
    full = {"R": (1, 0, 0), "Y": (1, 1, 0), "G": (0, 1, 0),
            "C": (0, 1, 1), "B": (0, 0, 1), "M": (1, 0, 1)}
    rows = [np.linspace(full[name[0]], full[name[1]], n, endpoint=False) for name, n in steps]
    return np.concatenate(rows).astype(np.float64).tobytes()


def color_flow(flow: NDArray[np.floating], largest: float) -> RgbImage:
    """RGB [H W 3] of a flow [H W 2] px, the Middlebury colours: hue is direction.

    Zero is white, a magnitude of `largest` px is saturated, what is larger is darker, NaN is
    NO_VALUE.
    """
    wheel = np.frombuffer(_wheel(), np.float64).reshape(-1, 3)
    valid = np.asarray(np.isfinite(flow).all(axis=-1))
    u, v = np.moveaxis(np.where(valid[..., None], flow, 0.0), -1, 0).astype(np.float64)
    radius = np.hypot(u, v) / max(largest, 1e-9)
    position = (np.arctan2(-v, -u) / np.pi + 1.0) / 2.0 * (len(wheel) - 1)
    low = np.floor(position).astype(np.intp)
    share = (position - low)[..., None]
    hue = (1.0 - share) * wheel[low % len(wheel)] + share * wheel[(low + 1) % len(wheel)]
    r = radius[..., None]
    out = np.rint(np.where(r <= 1.0, 1.0 - r * (1.0 - hue), 0.75 * hue) * 255).astype(np.uint8)
    out[~valid] = NO_VALUE
    return out


def flow_wheel(size: int) -> RgbImage:
    """RGB [size size 3]: the colour of each flow vector, seen from the middle; white outside."""
    c = (np.arange(size) - (size - 1) / 2) / ((size - 1) / 2)
    vectors = np.stack(np.meshgrid(c, c), axis=-1)
    out = color_flow(vectors, 1.0)
    out[np.hypot(vectors[..., 0], vectors[..., 1]) > 1.0] = 255
    return out
