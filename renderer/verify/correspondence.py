"""Checks of what a frame says of the next one: visibility, and what is where the flow leads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..types import OCCLUDED, OUT_OF_IMAGE, VISIBLE, Sequence
from .checks import Check, check, share
from .rays import FLAT, FLOW, Block, View, block, pixel_name
from .targets import Targets


def verify_correspondence(sequence: Sequence, t: int, visibility: NDArray[np.uint8],
                    forward: NDArray[np.float32], backward: NDArray[np.float32],
                    targets: Targets, here: View, there: View, motions: Array) -> list[Check]:
    """Visibility by its definition; depth and backward flow where the forward flow leads."""
    width, height = sequence.meta.width, sequence.meta.height
    unit = sequence.meta.depth_unit
    first = int(np.searchsorted(targets.part, 1))  # background has no visibility
    pixel, part = targets.pixel[first:], targets.part[first:]
    uv, z, slack = targets.uv[:, first:], targets.z[first:], targets.slack[:, first:]
    stored = visibility[pixel]
    uv = np.where(z > 0, np.clip(uv, -1e6, 1e6), -1e6)  # behind the camera is out of the image
    place = pixel_name(sequence, t)

    four = block(uv, part, there, width, height)
    suspect = np.flatnonzero(~_may_be(stored, uv, z, four, unit, width, height))
    wrong = np.ones(len(suspect), bool)
    for du in (-1, 1):  # a suspect is acquitted if half a unit of depth would explain it
        for dv in (-1, 1):
            around = uv[:, suspect] + [[du], [dv]] * (slack[:, suspect] + 1e-3)
            nearby = block(around, part[suspect], there, width, height)
            wrong &= ~_may_be(stored[suspect], around, z[suspect], nearby, unit, width, height)
    labelled = visibility != 0
    labelled[pixel] = labelled[targets.deforms] = False
    background = np.flatnonzero(labelled)
    bad = np.concatenate([pixel[suspect[wrong]], background]).astype(np.intp)
    checks = [share("visibility", np.ones(len(bad), bool), 1e-3, lambda i: place(int(bad[i])),
                    samples=max(len(pixel), len(bad)))]

    spread = four.far - four.near
    inner = np.flatnonzero((stored == VISIBLE) & four.same.all(0) & (spread < FLAT * z))
    weight, index = four.weight[:, inner], four.index[:, inner]
    spread, z, uv, part = spread[inner], z[inner], uv[:, inner], part[inner]
    gap = np.abs((weight * four.depth[:, inner]).sum(0) - z)
    # Half a unit is lost here and there; a surface that bends within the block stays within its
    # spread. A wire that is thinner than the block may be missed by it: what lies behind is as far
    # off as beside the wire's pixel. A few may lead to another sheet of the part: in renders of
    # four robots it was 0.1 % at most, while ray lengths taken for depth give 5 % and more.
    elsewhere = gap > 2 * unit + spread + _relief(here, width, height)[pixel[inner]]
    checks.append(share("depth where the flow leads", elsewhere, 0.01,
                        lambda i: place(int(pixel[inner[i]]))))

    # Backward flow is all but linear in pixel and depth: interpolating it errs by as much as the
    # interpolated depth does, by that depth's rounding, and by the square of the spread. What
    # remains are the bounds of both flows, and as much again for the bend within a pixel.
    there_and_back = forward[pixel[inner]].T + np.einsum("bm,bmc->cm", weight, backward[index])
    error = np.hypot(*there_and_back)
    k = sequence.state.intrinsics
    inverse = np.linalg.inv(motions)
    h = k @ inverse[:, :3, :3] @ np.linalg.inv(k)
    e = inverse[:, :3, 3] @ k.T
    ray = np.einsum("mij,jm->im", h[part], np.concatenate([uv, np.ones((1, len(inner)))]))
    e = e[part].T
    parallax = np.hypot(*((ray[:2] * e[2] - ray[2] * e[:2]) / (z * ray[2] + e[2]) ** 2))
    error = np.maximum(0, error - parallax * (gap + unit + 2 * spread**2 / z))
    known = np.isfinite(error) & ~elsewhere  # these count above, and in where flow is known
    error = error[known]
    places = pixel[inner][known]
    checks.append(check("there and back", error, 3 * FLOW, "px", lambda i: place(int(places[i]))))
    return checks


def _relief(view: View, width: int, height: int) -> Array:
    """[N] m, how far each depth is from a plane through its neighbours on opposite sides, at most;
    next to an edge, how far the edge drops.
    """
    z = np.pad(view.depth.reshape(height, width), 1, mode="edge")
    out = np.zeros((height, width))
    for du, dv in ((1, 0), (0, 1), (1, 1), (1, -1)):
        sides = [z[1 + s * dv : height + 1 + s * dv, 1 + s * du : width + 1 + s * du]
                 for s in (-1, 1)]
        out = np.maximum(out, np.abs(sides[0] + sides[1] - 2 * z[1:-1, 1:-1]))
    return out.ravel()


def _may_be(stored: NDArray[np.uint8], uv: Array, z: Array, four: Block, unit: float,
            width: int, height: int) -> NDArray[np.bool_]:
    """[M] whether the stored visibility can be right, with a tolerance of 20 % and a unit."""
    u, v = uv
    out = (u < -0.5) | (u >= width - 0.5) | (v < -0.5) | (v >= height - 0.5)
    tolerance = np.maximum(2 * unit, 0.002 * z)
    beyond = np.maximum(four.near - z, z - four.far)  # inf without a pixel of the part
    return np.where(out, stored == OUT_OF_IMAGE,
                    ((stored == VISIBLE) & (beyond <= 1.2 * tolerance + unit))
                    | ((stored == OCCLUDED) & (beyond > 0.8 * tolerance - unit)))
