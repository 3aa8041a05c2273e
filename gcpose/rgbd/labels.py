"""Parts from motion: labels by residuals summed over all frames (Sec. 3.2, EM).

The paper assigns a pixel to the part with the smallest epipolar loss between two frames. With depth
the residual is the distance of the pixel's moved point from the surface that a frame measures,
over all frames. A point in front of that surface contradicts free space; one behind it may be
hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, inverse
from ..images import Candidates, Surfaces
from ..numerics import thread_map
from .kernels import LabelCosts, add_label_costs, columns, flat_camera
from .settings import LabelSettings, RgbdSettings


@dataclass(frozen=True)
class Cloud:
    """Labelled points of one frame: a piece of the paper's point cloud model."""

    frame: int
    point: Array
    """[N 3] in that frame, camera frame, m"""
    normal: Array
    """[N 3]"""
    label: NDArray[np.int64]
    """[N] 0..J"""


class Clouds(tuple[Cloud, ...]):
    """Those of the key frames; the first is frame 0."""

    __slots__ = ()

    @property
    def label(self) -> NDArray[np.int64]:
        """[N] of frame 0."""
        return self[0].label


def part_centers(cloud: Cloud, joints: int) -> Array:
    """Return the mean point [J 3] of each joint's part; where it is hidden, that of all parts."""
    points, label = cloud.point, cloud.label
    middle = points[label > 0].mean(axis=0) if (label > 0).any() else np.zeros(3)
    mine = [points[label == j + 1] for j in range(joints)]
    return np.stack([m.mean(axis=0) if len(m) else middle for m in mine])


def changed_mask(surfaces: Surfaces, frame: int) -> NDArray[np.bool_]:
    """Return [H W] whether a pixel's depth in any frame differs from that in `frame`."""
    here = surfaces.depth[frame]
    tolerance = surfaces.tolerance(here)
    out = np.zeros(here.shape, bool)
    for depth in surfaces.depth:
        out |= np.abs(depth - here) > tolerance
    return out


def static_mask(
    surfaces: Surfaces, rgb: NDArray[np.uint8], frame: int, settings: LabelSettings
) -> NDArray[np.bool_]:
    """Return [H W] whether a pixel of `frame` shows a static surface.

    No frame sees through it, and some show it unchanged. A surface that hides it later may be close
    to it for long, but where the static one is visible again its depth is the same.
    """
    here = surfaces.depth[frame]
    votes = np.zeros(here.shape, np.int64)
    seen_through = np.zeros(here.shape, bool)
    gap = surfaces.tolerance(here) + settings.seen_through_noise * surfaces.noise
    for t, depth in enumerate(surfaces.depth):
        if t == frame:
            continue
        same = np.abs(depth - here) < settings.static_depth + settings.static_noise * surfaces.noise
        if surfaces.noise:
            same &= same_color(rgb[t], rgb[frame], settings)
        votes += np.where(same, settings.static_votes if abs(t - frame) == 1 else 1, 0)
        seen_through |= (depth > here + gap) | (depth == 0)
    return ~seen_through & (votes >= settings.static_votes)


def same_color(
    a: NDArray[np.uint8], b: NDArray[np.uint8], settings: LabelSettings
) -> NDArray[np.bool_]:
    """Return [H W] whether two images have the same colors around a pixel."""
    window = settings.static_window, settings.static_window
    red, green, blue = cv2.split(cv2.blur(cv2.absdiff(a, b), window))
    return cv2.max(red, cv2.max(green, blue)) <= settings.static_color


def moving_mask(
    surfaces: Surfaces, rgb: NDArray[np.uint8], settings: LabelSettings
) -> NDArray[np.bool_]:
    """Return [T H W] the pixels of each frame that may show a moving part; images [T H W 3] are
    used where depth has noise."""
    window = np.ones((settings.moving_window, settings.moving_window), np.uint8)

    def mask(frame: int) -> NDArray[np.bool_]:
        wide = cv2.dilate(changed_mask(surfaces, frame).astype(np.uint8), window) > 0
        known = surfaces.normal[frame].any(axis=2)
        return wide & known & ~static_mask(surfaces, rgb, frame, settings)

    return np.stack(thread_map(mask, range(surfaces.frames)))


def sample_candidates(
    surfaces: Surfaces, mask: NDArray[np.bool_], frame: int, most: int
) -> Candidates:
    """Sample about `most` of the pixels of a frame in a mask [H W], on a grid."""
    stride = max(1, int(np.ceil(np.sqrt(np.count_nonzero(mask) / most))))
    v, u = np.nonzero(mask[::stride, ::stride])
    pixel = np.stack([u, v], axis=1) * stride
    normal = surfaces.normal[frame, pixel[:, 1], pixel[:, 0]].astype(np.float64)
    return Candidates(frame, pixel, surfaces.points(frame, pixel), normal, stride,
                      surfaces.settings)


def label_costs(
    surfaces: Surfaces, grid: Candidates, motion: Array, settings: RgbdSettings,
    width: float = 1.0, first: int = 0,
) -> Array:
    """Return the cost [N P] of each label for the candidates, variances summed over T - 1 frames.

    Motions [T P 4 4] are of the parts `first` to `first + P - 1`; `width` is the standard deviation
    of a candidate's place, footprints of a pixel.
    """
    scale = width * (surfaces.footprint(grid.point[:, 2]) + surfaces.noise)
    here_from_there = motion @ inverse(motion[grid.frame])
    s = settings.labels
    numbers = (s.cost_seen_through, s.cost_hidden, s.cost_hidden_static, s.cost_outside,
               s.cost_turned_away, s.cost_other_surface, s.surface_gap,
               settings.bundle.min_normal_cosine)
    out = np.zeros((motion.shape[1], len(grid.point)), np.float32)
    add_label_costs(surfaces.depth, surfaces.normal, flat_camera(surfaces), grid.frame,
                    here_from_there.astype(np.float32), first,
                    columns(grid.point, grid.normal, scale),
                    LabelCosts(*(np.float32(n) for n in numbers)), out)
    return out.T.astype(np.float64)
