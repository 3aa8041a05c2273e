"""Checks of the images of a sequence against its state: every pixel, from geometry alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..types import Sequence
from .checks import Check, check, merge, share
from .correspondence import verify_correspondence
from .deforming import verify_deforming
from .rays import FLOW, View, pixel_name
from .targets import Targets, targets_of

_ENCODED = float(np.hypot(0.5, 0.5) / 64)
_RANGE = 512.0  # px, the largest flow that the files can hold


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
            ahead = targets_of(sequence, here, motions[t], parts)
            back = targets_of(sequence, there, np.linalg.inv(motions[t]), parts)
            f, b = forward.reshape(-1, 2), backward.reshape(-1, 2)
            checks += _flow(sequence, "flow forward", f, ahead, t)
            checks += _flow(sequence, "flow backward", b, back, t + 1)
            seen = visibility.ravel()
            checks += verify_correspondence(sequence, t, seen, f, b, ahead, here, there, motions[t])
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


def _flow(sequence: Sequence, name: str, flow: NDArray[np.float32], targets: Targets, t: int
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
