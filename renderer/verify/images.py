"""Checks of the images of a sequence against its state: every pixel, from geometry alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..types import Sequence
from .checks import CheckResult, check, check_share, merge_checks
from .correspondence import verify_correspondence
from .deforming import verify_deforming
from .frames import FLOW, FlowTargets, FrameStep, VerifiedFrame, decode_frame, flow_targets

_ENCODED = float(np.hypot(0.5, 0.5) / 64)
_RANGE = 512.0  # px, the largest flow that the files can hold


def verify_images(sequence: Sequence) -> list[CheckResult]:
    """Run all checks that need images; the state must have passed its own shape check."""
    meta = sequence.meta
    checks: list[CheckResult] = []
    here, motions = _decode(sequence, 0, checks), _motions(sequence)
    backdrops: list[bool] = []
    for t in range(meta.frames):
        if here is not None:
            checks += _frame(here, backdrops)
        if t + 1 == meta.frames:
            break
        there = _decode(sequence, t + 1, checks)
        size = (meta.height, meta.width)
        joining: list[tuple[NDArray[Any] | None, tuple[int, ...]]] = [
            (None if stack is None else stack[t], shape) for stack, shape in (
                (sequence.flow, (*size, 2)), (sequence.flow_backward, (*size, 2)),
                (sequence.visibility, size))]
        wrong = any(image is not None and np.shape(image) != shape for image, shape in joining)
        checks.append(check("image shapes", wrong, 0, "frames", f"frame {t} flow or visibility"))
        if here is not None and there is not None and checks[-1].ok:
            flat = [None if image is None else image.reshape(-1, *shape[2:])
                    for image, shape in joining]
            checks += _step(FrameStep(here, there, motions[t], *flat))
        here = there
    mixed = len(set(backdrops)) > 1
    checks.append(check("background all surface or none", mixed, 0, "frames",
                        "some frames have a room, others do not", samples=len(backdrops)))
    return list(merge_checks(checks))


def _step(step: FrameStep) -> list[CheckResult]:
    ahead = flow_targets(step.here, step.motions)
    checks = [*verify_correspondence(step, ahead), *verify_deforming(step)]
    if step.backward is not None:
        back = flow_targets(step.there, np.linalg.inv(step.motions).astype(np.float64))
        checks = [*_flow(step.there, "flow backward", step.backward, back), *checks]
    if step.forward is not None:
        checks = [*_flow(step.here, "flow forward", step.forward, ahead), *checks]
    return checks


def _motions(sequence: Sequence) -> Array:
    """[T-1 P+1 4 4] how each part number moves in the camera from a frame to the next."""
    s = sequence.state
    world = np.broadcast_to(np.eye(4), (len(s.times), 1, 4, 4))  # part 0 stands still
    cam_from_part = s.cam_from_world[:, None] @ np.concatenate([world, s.world_from_part], axis=1)
    return cam_from_part[1:] @ np.linalg.inv(cam_from_part[:-1])


def _decode(sequence: Sequence, t: int, checks: list[CheckResult]) -> VerifiedFrame | None:
    """The decoded frame; None if an image is of the wrong kind."""
    meta = sequence.meta
    size = (meta.height, meta.width)
    rgb, depth, part = sequence.rgb[t], sequence.depth[t], sequence.part[t]
    ok = (np.shape(rgb) == (*size, 3) and rgb.dtype == np.uint8 and np.shape(depth) == size
          and np.shape(part) == size and np.issubdtype(part.dtype, np.integer))
    checks.append(check("image shapes", not ok, 0, "frames", f"frame {t}"))
    return decode_frame(sequence, t) if ok else None


def _frame(frame: VerifiedFrame, backdrops: list[bool]) -> list[CheckResult]:
    """One frame by itself: part numbers, pixel counts, range of depth, background."""
    sequence, part, depth = frame.sequence, frame.part, frame.depth
    meta = sequence.meta
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
        check_share("part numbers in range", alien, 0, frame.name),
        check("part_pixels", counts - sequence.state.part_pixels[frame.t], 0, "px",
              lambda i: f"frame {frame.t} part {i + 1}"),
        check_share("depth in range", off, 0, frame.name),
        check("depth unit", not 1e-9 <= meta.depth_unit <= 1e3, 0, "", "meta.json"),
        check_share("surface where there is a part or room", wrong, 0, frame.name)]


def _flow(
    frame: VerifiedFrame, name: str, flow: NDArray[np.float32], targets: FlowTargets
) -> list[CheckResult]:
    """The stored flow [N 2] of a frame is right, and known exactly where a target is."""
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
    index = np.concatenate([targets.pixel[used], rest])
    return [check(name, error, FLOW, "px", lambda i: frame.name(int(index[i]))),
            check_share(f"{name}: known where it should be", wrong, 0, frame.name)]
