"""Checks of a frame against the next: visibility, and what is where the flow leads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..types import OCCLUDED, OUT_OF_IMAGE, VISIBLE
from .checks import CheckResult, check, check_share
from .frames import FLAT, FLOW, FlowTargets, FrameStep, Index, PixelBlock, VerifiedFrame


def verify_correspondence(step: FrameStep, targets: FlowTargets) -> list[CheckResult]:
    """Check visibility by its definition, and depth and backward flow where the flow leads."""
    first = int(np.searchsorted(targets.part, 1))  # background has no visibility
    pixel, part = targets.pixel[first:], targets.part[first:]
    z, uv = targets.z[first:], targets.uv[:, first:]
    uv = np.where(z > 0, np.clip(uv, -1e6, 1e6), -1e6)  # behind the camera is out of the image
    four = step.there.around(uv, part)
    if step.visibility is None:
        stored, checks = _expect_visibility(step.there, z, four), list[CheckResult]()
    else:
        stored = step.visibility[pixel]
        checks = [_visibility(step, targets, uv, four, step.visibility)]

    inner = np.flatnonzero(
        (stored == VISIBLE) & four.same.all(0) & (four.far - four.near < FLAT * z))
    weight, index = four.weight[:, inner], four.index[:, inner]
    spread = (four.far - four.near)[inner]
    depth = (weight * four.depth[:, inner]).sum(0)
    gap = np.abs(depth - z[inner])
    # Half a unit is lost here and there; a surface that bends within the block stays within its
    # spread. A wire that is thinner than the block may be missed by it: what lies behind is as far
    # off as beside the wire's pixel. A few may lead to another sheet of the part: in renders of
    # four robots it was 0.1 % at most, while ray lengths taken for depth give 5 % and more.
    unit, pixel = step.here.unit, pixel[inner]
    elsewhere = gap > 2 * unit + spread + _relief(step.here)[pixel]
    checks.append(check_share("depth where the flow leads", elsewhere, 0.01,
                              lambda i: step.here.name(int(pixel[i]))))

    if step.forward is None or step.backward is None:
        return checks
    # Backward flow is all but linear in pixel and depth: interpolating it errs by as much as the
    # interpolated depth does, by that depth's rounding, and by the square of the spread. What
    # remains are the bounds of both flows, and as much again for the bend within a pixel.
    there_and_back = step.forward[pixel].T + np.einsum("bm,bmc->cm", weight, step.backward[index])
    allowed = gap + unit + 2 * spread**2 / z[inner]
    parallax = _parallax(step, part[inner], uv[:, inner], z[inner], depth)
    error = np.maximum(0, np.hypot(*there_and_back) - parallax * allowed)
    known = np.isfinite(error) & ~elsewhere  # these count above, and in where flow is known
    places = pixel[known]
    checks.append(check("there and back", error[known], 3 * FLOW, "px",
                        lambda i: step.here.name(int(places[i]))))
    return checks


def _visibility(
    step: FrameStep, targets: FlowTargets, uv: Array, four: PixelBlock,
    visibility: NDArray[np.uint8],
) -> CheckResult:
    """The stored visibility [N] of parts at targets [2 M], and that the background has none.

    A suspect is acquitted if half a unit of depth would explain it.
    """
    first = len(targets.pixel) - len(four.near)
    pixel, part, z = targets.pixel[first:], targets.part[first:], targets.z[first:]
    slack, stored = targets.slack[:, first:], visibility[pixel]
    suspect = np.flatnonzero(~_plausible(step.there, stored, uv, z, four))
    wrong = np.ones(len(suspect), bool)
    for du in (-1, 1):
        for dv in (-1, 1):
            moved = uv[:, suspect] + [[du], [dv]] * (slack[:, suspect] + 1e-3)
            nearby = step.there.around(moved, part[suspect])
            wrong &= ~_plausible(step.there, stored[suspect], moved, z[suspect], nearby)
    labelled = visibility != 0
    labelled[pixel] = labelled[targets.deforms] = False
    bad: Index = np.concatenate([pixel[suspect[wrong]], np.flatnonzero(labelled)]).astype(np.intp)
    return check_share("visibility", np.ones(len(bad), bool), 1e-3,
                       lambda i: step.here.name(int(bad[i])), max(len(pixel), len(bad)))


def _expect_visibility(there: VerifiedFrame, z: Array, four: PixelBlock) -> NDArray[np.uint8]:
    """[M] the visibility where it is not stored: a point is hidden only behind what is seen.

    One that is before it contradicts the images.
    """
    behind = z - four.far > np.maximum(2 * there.unit, 0.002 * z)
    return np.where(behind, OCCLUDED, VISIBLE).astype(np.uint8)


def _plausible(
    there: VerifiedFrame, stored: NDArray[np.uint8], uv: Array, z: Array, four: PixelBlock
) -> NDArray[np.bool_]:
    """[M] whether the stored visibility can be right, with a tolerance of 20 % and a unit."""
    tolerance = np.maximum(2 * there.unit, 0.002 * z)
    beyond = np.maximum(four.near - z, z - four.far)  # inf without a pixel of the part
    (u, v), meta = uv, there.sequence.meta
    out = (u < -0.5) | (u >= meta.width - 0.5) | (v < -0.5) | (v >= meta.height - 0.5)
    return np.where(out, stored == OUT_OF_IMAGE,
                    ((stored == VISIBLE) & (beyond <= 1.2 * tolerance + there.unit))
                    | ((stored == OCCLUDED) & (beyond > 0.8 * tolerance - there.unit)))


def _parallax(
    step: FrameStep, part: NDArray[np.int64], uv: Array, z: Array, other: Array
) -> Array:
    """[M] px/m, how the way back from targets [2 M] changes from depth z [M] to the other [M].

    Exact, because beside an edge these are centimetres apart.
    """
    k, inverse = step.here.sequence.state.intrinsics, np.linalg.inv(step.motions)
    h = k @ inverse[:, :3, :3] @ np.linalg.inv(k)
    e = (inverse[:, :3, 3] @ k.T)[part].T
    ray = np.einsum("mij,jm->im", h[part], np.concatenate([uv, np.ones((1, len(part)))]))
    scale = (z * ray[2] + e[2]) * (other * ray[2] + e[2])
    return np.hypot(*((ray[:2] * e[2] - ray[2] * e[:2]) / scale))


def _relief(frame: VerifiedFrame) -> Array:
    """[N] m, the largest distance of each depth from a plane through its neighbors on opposite
    sides; next to an edge, how far the edge drops.
    """
    width, height = frame.sequence.meta.width, frame.sequence.meta.height
    z = np.pad(frame.depth.reshape(height, width), 1, mode="edge")
    out = np.zeros((height, width))
    for du, dv in ((1, 0), (0, 1), (1, 1), (1, -1)):
        sides = [z[1 + s * dv : height + 1 + s * dv, 1 + s * du : width + 1 + s * du]
                 for s in (-1, 1)]
        out = np.maximum(out, np.abs(sides[0] + sides[1] - 2 * z[1:-1, 1:-1]))
    return out.ravel()
