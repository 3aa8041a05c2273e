"""The three directions of a box by straight edges: what slides out of it moves along one of them.

Most straight edges of a drawer and of its body have one of three directions at right angles (as
those of a "Manhattan world": Coughlan and Yuille, ICCV 1999). A slide does not change them, so that
the edges of all frames count together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robots.geometry import Array, se3
from .door_edges import across_axis
from .edge_planes import EdgePlanes
from .settings import RgbSettings

_TRIED_TURNS = np.arange(60) * np.pi / 120  # about each direction: a quarter turn gives the same
_WEAK_PRIOR = 1e-6  # information about the turn of the box, 1/rad^2


@dataclass(frozen=True, eq=False)
class BoxDirections:
    """Three directions at right angles by straight edges."""

    axes: Array
    """[3 3] unit vectors in rows, in the frame of the camera"""
    deviation: float = np.inf
    """Standard deviation of the turn of all three, rad"""
    explained: float = 0.0
    """Share of the moving edges that have one of them, by length; a mean over the frames"""
    second: float = 0.0
    """Share of those that have another one than most of them"""

    def nearest_first(self, direction: Array) -> Array:
        """Return the axes [3 3] in the order of their angles with a direction [3]."""
        return self.axes[np.argsort(-np.abs(self.axes @ direction), kind="stable")]


def find_box_directions(
    moving: EdgePlanes, still: EdgePlanes, settings: RgbSettings
) -> BoxDirections | None:
    """Return the directions of a box, by the edges of what moves and those that stand still; None
    where they do not tell them."""
    s = settings
    if len(np.unique(moving.frame)) < max(2.0, s.min_edge_frames * moving.frames):
        return None
    found = [refine_box_directions(moving, still, axes, s)
             for axes in propose_box_directions(moving, s)]
    best = max(found, key=lambda box: box.explained, default=None)
    if best is None:
        return None
    told = (best.explained >= s.min_box_share and best.second >= s.min_box_second
            and best.deviation <= s.max_axis_sigma)
    return best if told else None


def propose_box_directions(planes: EdgePlanes, settings: RgbSettings) -> list[Array]:
    """Return directions [3 3] of boxes: one along which many edges are, and the best turn about
    it."""
    out: list[Array] = []
    for axis in planes.common_directions(settings):
        one, other = across_axis(axis)
        boxes = [np.stack([axis, *(np.cos(turn) * u + np.sin(turn) * v
                                   for u, v in ((one, other), (other, -one)))])
                 for turn in _TRIED_TURNS]
        out.append(max(boxes, key=lambda box: explained_share(planes, box, settings)))
    return out


def refine_box_directions(
    moving: EdgePlanes, still: EdgePlanes, axes: Array, settings: RgbSettings
) -> BoxDirections:
    """Return the box near directions [3 3] that fits best: robust Gauss-Newton. An edge counts for
    the direction that it fits best."""
    matrix = np.eye(3)
    for _ in range(settings.axis_rounds):
        matrix, vector = _WEAK_PRIOR * np.eye(3), np.zeros(3)
        for planes in (moving, still):
            off, sigma, weight = (np.stack(x) for x in zip(
                *(planes.fit(axis, settings) for axis in axes), strict=True))
            k, edge = weight.argmax(axis=0), np.arange(len(planes.frame))
            certain = weight[k, edge] / sigma[k, edge]
            gradient = np.cross(axes[k], planes.normal) * certain[:, None]
            matrix += gradient.T @ gradient
            vector += gradient.T @ (certain * off[k, edge])
        step = -np.linalg.solve(matrix, vector)
        step *= min(1.0, settings.max_axis_step / max(1e-12, float(np.linalg.norm(step))))
        axes = axes @ se3.so3_exp(step).T
    deviation = float(np.sqrt(np.trace(np.linalg.inv(matrix))))
    weight = np.stack([moving.fit(axis, settings)[2] for axis in axes])
    explained = weight.max(axis=0) * moving.share
    first = weight[(weight @ moving.share).argmax()]
    return BoxDirections(
        axes, deviation, float(explained.sum()), float(explained[first < 0.5].sum()))


def explained_share(planes: EdgePlanes, axes: Array, settings: RgbSettings) -> float:
    """Return the share of the edges that have one of three directions [3 3]; 0 without edges."""
    weights = [planes.fit(axis, settings)[2] for axis in axes]
    return float(np.max(weights, axis=0) @ planes.share)
