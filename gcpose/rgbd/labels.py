"""Parts from motion: labels by residuals that are accumulated over all frames (Sec. 3.2, EM).

The paper assigns a pixel to the part whose epipolar loss is least, between two frames. With depth
the residual is where the hypothesis puts the pixel's point against what the later frame measures
there, over every frame; a point in front of the measured surface contradicts free space, a point
behind it may be hidden.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, inverse
from ..images import Candidates, Surfaces
from ..numerics import together
from .kernels import LabelCosts, add_label_costs, camera_of, columns
from .settings import LabelSettings, RgbdSettings


def changed(surfaces: Surfaces, frame: int) -> NDArray[np.bool_]:
    """[H W] whether a pixel's depth ever differs from that in `frame`."""
    here = surfaces.depth[frame]
    tolerance = surfaces.tolerance(here)
    out = np.zeros(here.shape, bool)
    for depth in surfaces.depth:
        out |= np.abs(depth - here) > tolerance
    return out


def settled(
    surfaces: Surfaces, rgb: NDArray[np.uint8], frame: int, settings: LabelSettings
) -> NDArray[np.bool_]:
    """[H W] whether a pixel of `frame` looks still: never seen through, and seen again unchanged.

    What hides it later may be near it for long; where it reappears, or has not been hidden yet,
    its depth is the same to the last digit.
    """
    here = surfaces.depth[frame]
    again = np.zeros(here.shape, np.int64)
    through = np.zeros(here.shape, bool)
    for t, depth in enumerate(surfaces.depth):
        if t == frame:
            continue
        same = np.abs(depth - here) < settings.static_depth + settings.static_noise * surfaces.noise
        if surfaces.noise:
            same &= alike(rgb[t], rgb[frame], settings)
        again += np.where(same, settings.static_votes if abs(t - frame) == 1 else 1, 0)
        gap = surfaces.tolerance(here) + settings.seen_through_noise * surfaces.noise
        through |= (depth > here + gap) | (depth == 0)
    return ~through & (again >= settings.static_votes)


def alike(
    a: NDArray[np.uint8], b: NDArray[np.uint8], settings: LabelSettings
) -> NDArray[np.bool_]:
    """[H W] whether two images show the same around a pixel."""
    window = settings.static_window, settings.static_window
    red, green, blue = cv2.split(cv2.blur(cv2.absdiff(a, b), window))
    return cv2.max(red, cv2.max(green, blue)) <= settings.static_color


def lively(
    surfaces: Surfaces, rgb: NDArray[np.uint8], settings: LabelSettings
) -> NDArray[np.bool_]:
    """[T H W] in and around the pixels of each frame that change."""

    window = np.ones((settings.moving_window, settings.moving_window), np.uint8)

    def of(frame: int) -> NDArray[np.bool_]:
        moving = changed(surfaces, frame).astype(np.uint8)
        wide = cv2.dilate(moving, window) > 0
        return wide & surfaces.normal[frame].any(axis=2) & ~settled(surfaces, rgb, frame, settings)

    return np.stack(together(of, range(surfaces.frames)))


def candidates(
    surfaces: Surfaces, where: NDArray[np.bool_], frame: int, most: int
) -> Candidates:
    """At most about `most` of the pixels of a frame that are told [H W]."""
    stride = max(1, int(np.ceil(np.sqrt(np.count_nonzero(where) / most))))
    v, u = np.nonzero(where[::stride, ::stride])
    pixel = np.stack([u, v], axis=1) * stride
    normal = surfaces.normal[frame, pixel[:, 1], pixel[:, 0]].astype(np.float64)
    return Candidates(frame, pixel, surfaces.points(frame, pixel), normal, stride,
                      surfaces.settings)


def label_costs(
    surfaces: Surfaces, grid: Candidates, motion: Array, settings: RgbdSettings,
    width: float = 1.0, first: int = 0,
) -> Array:
    """[N P] cost of each label for the candidates under motion [T P 4 4] of the parts `first` to
    `first` + P - 1, over T - 1 frames.

    `width` is what the motion may err by, in footprints of a pixel.
    """
    scale = width * (surfaces.footprint(grid.point[:, 2]) + surfaces.noise)
    here_from_there = motion @ inverse(motion[grid.frame])
    out = np.zeros((motion.shape[1], len(grid.point)), np.float32)
    add_label_costs(surfaces.depth, surfaces.normal, camera_of(surfaces.intrinsics, surfaces.depth),
                    grid.frame, here_from_there.astype(np.float32), first,
                    columns(grid.point, grid.normal, scale), costs_of(settings), out)
    return out.T.astype(np.float64)


def costs_of(settings: RgbdSettings) -> LabelCosts:
    """The settings of label costs in single precision."""
    s = settings.labels
    numbers = (s.cost_seen_through, s.cost_hidden, s.cost_hidden_static, s.cost_outside,
               s.cost_turned_away, s.cost_other_surface, s.surface_gap,
               settings.bundle.min_normal_cosine)
    return LabelCosts(*(np.float32(n) for n in numbers))
