"""Other views of depth videos: the camera turns, lengths change, and a mirror. Labels follow.

With depth, these are exact: a camera that turns about its center sees the same surfaces, and a
larger object that is further away has the same image with larger depths.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Sequence
from ...robots.geometry import Array, fit_intrinsics, se3
from .config import ViewConfig

SAME_VIEW = ViewConfig()
"""No other views."""
MIRROR = np.diag([-1.0, 1.0, 1.0])
"""Mirrors a frame whose x axis is lateral: that of the camera, and that of an appliance."""
_LEAST_AHEAD = 0.1  # depth of a ray of unit depth in the other view


@dataclass(frozen=True)
class View:
    """Points x of the camera's frame go to `scale` times `turn` x."""

    turn: Array
    """[3 3], with determinant -1 where it mirrors"""
    scale: float

    @property
    def mirrors(self) -> bool:
        """Whether left and right are exchanged."""
        return bool(np.linalg.det(self.turn) < 0)


def fitted_intrinsics(sequence: Sequence) -> Array:
    """Return the intrinsics [3 3] of the images of a sequence after `fit_depth`."""
    meta = sequence.meta
    return fit_intrinsics(sequence.state.intrinsics, meta.width, meta.height)


def joint_slides(sequence: Sequence) -> bool:
    """Return whether the scored joint of a sequence slides."""
    meta = sequence.meta
    return meta.joint_types[meta.joint_names.index(meta.scored_joints[0])] == "prismatic"


def draw_view(rng: np.random.Generator, config: ViewConfig) -> View:
    """Return a random view."""
    turn = se3.so3_exp(np.radians(rng.uniform(-config.turn, config.turn, 3)))
    mirror = MIRROR if rng.random() < config.mirror else np.eye(3)
    return View(turn @ mirror, float(np.exp(rng.uniform(*np.log(config.scale)))))


def view_depth(
    depth: NDArray[np.float32], intrinsics: Array, view: View
) -> NDArray[np.float32]:
    """Return depth images [T H W] in another view, of the same size and intrinsics [3 3].

    Pixels are the nearest ones; zero is what the images do not show.
    """
    height, width = depth.shape[1:]
    ray = view.turn.T @ np.linalg.inv(intrinsics)  # times a pixel, in the frame of the images
    ahead = np.maximum(_over_pixels(ray[2], height, width), _LEAST_AHEAD)
    u, v = (_over_pixels(row @ ray, height, width) / ahead for row in intrinsics[:2])
    factor = np.float32(view.scale) / ahead
    return np.stack([cv2.remap(image, u, v, cv2.INTER_NEAREST) * factor for image in depth])


def _over_pixels(row: Array, height: int, width: int) -> NDArray[np.float32]:
    """Return the products [H W] of a row [3] with the pixels (u, v, 1) of an image."""
    u, v = (np.arange(n, dtype=np.float64) for n in (width, height))
    return (row[0] * u + (row[1] * v + row[2])[:, None]).astype(np.float32)


def view_screws(screw: Array, view: View, slides: bool) -> Array:
    """Return relative screws [K 8] (see `screws.relative_screws`) in another view."""
    l, m, theta, d = np.split(screw, [3, 6, 7], axis=1)
    sign = -1.0 if view.mirrors and not slides else 1.0  # a mirror reverses turns
    return np.concatenate([sign * l @ view.turn.T, view.scale * m @ view.turn.T, theta,
                           view.scale * d], axis=1)
