"""Checks of the images of a sequence against its state: every pixel, from geometry alone.

A pixel's surface point moves with its part, so with H = K R inv(K) and e = K t of that motion the
target's (u' w, v' w, w) is z H (u, v, 1) + e. This is not the way the renderer computes flow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array
from .residual import Check, check, merge, share
from .sequence import OCCLUDED, OUT_OF_IMAGE, VISIBLE, Sequence
from .verify_deforming import verify_deforming
from .verify_view import FLAT, FLOW, Block, Index, View, block, deforming_numbers, pixel_name

_ENCODED = float(np.hypot(0.5, 0.5) / 64)
_RANGE = 512.0  # px, the largest flow that the files can hold


@dataclass(frozen=True)
class _Targets:
    """Where the surface pixels of a frame are in another frame. M pixels, sorted by part."""

    rest: Index
    """[K] flat index of a background that stands still, as a room does"""
    deforms: Index
    """flat index of the pixels of deforming parts, which verify_deforming.py looks at"""

    pixel: Index
    """[M] flat index"""
    part: NDArray[np.int64]
    """[M]"""
    start: Array
    """[2 M] px, the pixel itself"""
    uv: Array
    """[2 M] px"""
    z: Array
    """[M] m, not positive behind the camera"""
    slack: Array
    """[2 M] px, change of uv for half a unit of depth"""


def verify_images(sequence: Sequence) -> list[Check]:
    """All checks that need images; the state must have passed its own shape check."""
    meta = sequence.meta
    parts = len(meta.part_names)
    checks: list[Check] = []
    here, motions = _view(sequence, 0, checks), _motions(sequence)
    backdrops: list[bool] = []
    for t in range(meta.frames):
        checks += _frame(sequence, t, here, backdrops)
        if t + 1 == meta.frames:
            break
        there = _view(sequence, t + 1, checks)
        forward, backward = sequence.flow[t], sequence.flow_backward[t]
        visibility = sequence.visibility[t]
        shapes = [np.shape(x) for x in (forward, backward, visibility)]
        size = (meta.height, meta.width)
        checks.append(check("image shapes", shapes != [(*size, 2), (*size, 2), size], 0, "frames",
                            f"frame {t} flow or visibility"))
        if here is not None and there is not None and checks[-1].ok:
            ahead = _targets(sequence, here, motions[t], parts)
            back = _targets(sequence, there, np.linalg.inv(motions[t]), parts)
            f, b = forward.reshape(-1, 2), backward.reshape(-1, 2)
            checks += _flow(sequence, "flow forward", f, ahead, t)
            checks += _flow(sequence, "flow backward", b, back, t + 1)
            seen = visibility.ravel()
            checks += _correspondence(sequence, t, seen, f, b, ahead, here, there, motions[t])
            checks += verify_deforming(sequence, t, here, there, f, b, seen)
        here = there
    mixed = len(set(backdrops)) > 1
    checks.append(check("background all surface or none", mixed, 0, "frames",
                        "some frames have a room, some have not", samples=len(backdrops)))
    return list(merge(checks))


def _motions(sequence: Sequence) -> Array:
    """[T-1 P+1 4 4] how each part number moves in the camera from a frame to the next."""
    s = sequence.state
    world = np.broadcast_to(np.eye(4), (len(s.times), 1, 4, 4))  # part 0 stands still
    cam_from_part = s.cam_from_world[:, None] @ np.concatenate([world, s.world_from_part], axis=1)
    return cam_from_part[1:] @ np.linalg.inv(cam_from_part[:-1])


def _view(sequence: Sequence, t: int, checks: list[Check]) -> View | None:
    """The decoded frame, None if it is no image of the right kind."""
    meta = sequence.meta
    size = (meta.height, meta.width)
    rgb, depth, part = sequence.rgb[t], sequence.depth[t], sequence.part[t]
    ok = (np.shape(rgb) == (*size, 3) and rgb.dtype == np.uint8 and np.shape(depth) == size
          and np.shape(part) == size and np.issubdtype(part.dtype, np.integer))
    checks.append(check("image shapes", not ok, 0, "frames", f"frame {t}"))
    if not ok:
        return None
    return View(part.ravel().astype(np.int64), depth.ravel().astype(np.float64))


def _frame(sequence: Sequence, t: int, view: View | None, backdrops: list[bool]) -> list[Check]:
    """One frame by itself: part numbers, pixel counts, range of depth, background."""
    if view is None:
        return []
    meta, part, depth = sequence.meta, view.part, view.depth
    pixel = pixel_name(sequence, t)
    parts = len(meta.part_names)
    alien = (part < 0) | (part > parts)
    counts = np.bincount(np.where(alien, 0, part), minlength=parts + 1)[1:]
    largest = 65535 * meta.depth_unit
    # A depth at the end of the scale was clipped: its surface is somewhere behind.
    off = ~np.isfinite(depth) | (depth < 0) | (depth >= largest - meta.depth_unit / 2)
    empty = part == 0
    surface = depth > 0
    if empty.any():
        backdrops.append(bool(surface[empty].mean() > 0.5))
    wrong = np.where(empty, surface != bool(backdrops and backdrops[-1]), ~surface)
    return [
        share("part numbers in range", alien, 0, pixel),
        check("part_pixels", counts - sequence.state.part_pixels[t], 0, "px",
              lambda i: f"frame {t} part {i + 1}"),
        share("depth in range", off, 0, pixel),
        check("depth unit", not 1e-9 <= meta.depth_unit <= 1e3, 0, "", "meta.json"),
        share("surface where there is a part or room", wrong, 0, pixel)]


def _targets(sequence: Sequence, view: View, motions: Array, parts: int) -> _Targets:
    """Every surface pixel, moved by its part's motion [P+1 4 4] and projected."""
    k = sequence.state.intrinsics
    k_inverse, half = np.linalg.inv(k), sequence.meta.depth_unit / 2
    surface = view.depth > 0
    groups = [np.flatnonzero(surface & (view.part == p)) for p in range(parts + 1)]
    loose = deforming_numbers(sequence)
    deforms = np.concatenate([groups[0][:0], *(groups[p] for p in loose)])
    for p in loose:
        groups[p] = groups[p][:0]
    stands = np.abs(motions - np.eye(4)).max((-1, -2)) < 1e-12
    rest = groups[0][:0]
    if stands[0]:  # most pixels of a room: what is known of them need not be computed
        rest, groups[0] = groups[0], rest
    numbers = np.repeat(np.arange(parts + 1), [len(g) for g in groups])
    pixel = np.concatenate(groups)
    v, u = np.divmod(pixel, sequence.meta.width)
    start, z = np.stack([u, v]).astype(np.float64), view.depth[pixel]
    uv, w, slack = start.copy(), z.copy(), np.zeros_like(start)
    end = 0
    for p, group in enumerate(groups):
        begin, end = end, end + len(group)
        if begin == end or stands[p]:
            continue
        i = slice(begin, end)
        h, e = k @ motions[p, :3, :3] @ k_inverse, k @ motions[p, :3, 3]
        ray = h[:, :2] @ start[:, i] + h[:, 2:]
        moved = ray * z[i] + e[:, None]
        w[i] = moved[2]
        uv[:, i] = moved[:2] / moved[2]
        slack[:, i] = half * np.abs(ray[:2] * e[2] - ray[2] * e[:2, None]) / moved[2] ** 2
    return _Targets(rest, deforms, pixel, numbers, start, uv, w, slack)


def _flow(sequence: Sequence, name: str, flow: NDArray[np.float32], targets: _Targets, t: int
          ) -> list[Check]:
    """Stored flow [N 2] of frame t: right, and there exactly where a target is."""
    finite = np.isfinite(flow)
    known: NDArray[np.bool_] = finite[:, 0] & finite[:, 1]
    half_known: NDArray[np.bool_] = finite[:, 0] ^ finite[:, 1]
    expected = targets.uv - targets.start
    reach = np.abs(expected).max(0)
    ahead = targets.z > 0
    required, allowed = ahead & (reach < _RANGE - 0.1), ahead
    stored = known[targets.pixel]
    wrong = known | half_known  # outside the surface pixels, none may be known
    wrong[targets.pixel] = (required & ~stored) | (stored & ~allowed) | half_known[targets.pixel]
    wrong[targets.rest] = ~known[targets.rest]
    wrong[targets.deforms] = half_known[targets.deforms]

    used = np.flatnonzero(stored & ahead)
    error = np.hypot(*(flow[targets.pixel[used]].T - expected[:, used]))
    # What the two quantisations alone can cost beyond the bound is not the flow's fault.
    quantised = np.hypot(*targets.slack[:, used])
    error = np.maximum(0, error - np.maximum(0, quantised + _ENCODED - FLOW))
    rest = targets.rest[known[targets.rest]]
    error = np.concatenate([error, np.hypot(flow[rest, 0], flow[rest, 1])])
    pixel, index = pixel_name(sequence, t), np.concatenate([targets.pixel[used], rest])
    return [check(name, error, FLOW, "px", lambda i: pixel(int(index[i]))),
            share(f"{name}: known where it should be", wrong, 0, pixel)]


def _correspondence(sequence: Sequence, t: int, visibility: NDArray[np.uint8],
                    forward: NDArray[np.float32], backward: NDArray[np.float32],
                    targets: _Targets, here: View, there: View, motions: Array) -> list[Check]:
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

