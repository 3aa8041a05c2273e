"""Checks of keypoints and tracks against poses, camera, depth and flow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ...robots.model import ArticulatedModel
from ..types import Sequence
from .checks import CheckResult, check, check_share, merge_checks
from .frames import FLOW, METRES, PixelBlock, VerifiedFrame, decode_frame, deforming_numbers

_PIXELS = 1e-4  # px, bound of positions that only rounding may change


def verify_tracks(sequence: Sequence, model: ArticulatedModel | None = None) -> list[CheckResult]:
    """Check the layers `keypoints` and `tracks`; keypoints also against the model, if given."""
    layers, checks = sequence.meta.layers, list[CheckResult]()
    if "keypoints" in layers:
        checks += _keypoints(sequence, model)
    if "tracks" in layers:
        checks += _tracks(sequence)
    return list(merge_checks(checks))


def _keypoints(sequence: Sequence, model: ArticulatedModel | None) -> list[CheckResult]:
    meta, s = sequence.meta, sequence.state
    part, world, visible = s.keypoint_part, s.keypoint_world, s.keypoint_visible
    assert part is not None and world is not None and visible is not None
    checks = [_numbers("keypoint", part, sequence)]
    if not checks[0].ok:
        return checks
    local = _in_parts(sequence, part, world)
    checks.append(_still("keypoint", local, np.ones(len(part), bool)))
    if model is not None and model.part_names == meta.part_names:
        same = model.keypoint_names == meta.keypoint_names
        checks.append(check("keypoints of the model", not same, 0, "sequences", "other names"))
        if same:
            checks.append(check("keypoint: where the model has it", local - model.keypoint, METRES,
                                "m", lambda i: meta.keypoint_names[i // 3 % max(len(part), 1)]))
    projection, z = _projection("keypoint", sequence, world, s.keypoint_image)
    checks += projection
    slack = meta.depth_unit
    for t in range(meta.frames):
        inside, border, around = _around(sequence, t, s.keypoint_image, part)
        depth = np.where(around.depth > 0, around.depth, np.inf)
        depth = np.where(around.inside, depth, -np.inf)
        beyond = z[t] - depth.max(axis=0) - meta.keypoint_tolerance
        sure = ~border & (np.abs(beyond) > slack)
        wrong = sure & (visible[t] != (inside & (beyond <= 0)))
        checks.append(check_share("keypoint: visible", wrong, 0,
                            lambda i, t=t: f"frame {t} {meta.keypoint_names[i]}"))
    return checks


def _tracks(sequence: Sequence) -> list[CheckResult]:
    meta, s = sequence.meta, sequence.state
    part, query, world, image, visible = (
        s.track_part, s.track_query, s.track_world, s.track_image, s.track_visible)
    assert part is not None and query is not None and world is not None
    assert image is not None and visible is not None
    checks = [_numbers("track", part, sequence),
              check("track: query frames", (query < 0) | (query >= meta.frames), 0, "points")]
    if not all(c.ok for c in checks):
        return checks
    rigid = ~np.isin(part, deforming_numbers(sequence))
    checks.append(_still("track", _in_parts(sequence, part, world), rigid))
    projection, z = _projection("track", sequence, world, image)
    checks += projection
    checks += _queries(sequence, image, z)
    for t in range(meta.frames):
        inside, border, around = _around(sequence, t, image, part)
        tolerance = np.maximum(2 * meta.depth_unit, 0.002 * z[t])
        beyond = np.maximum(around.near - z[t], z[t] - around.far)
        sure = ~border & ((beyond > 1.2 * tolerance + meta.depth_unit)
                          | (beyond < 0.8 * tolerance - meta.depth_unit))
        wrong = sure & (visible[t] != (inside & (beyond <= tolerance)))
        checks.append(check_share("track: visible", wrong, 0,
                            lambda i, t=t: f"frame {t} point {i}"))
    return checks


def _queries(sequence: Sequence, image: Array, z: Array) -> list[CheckResult]:
    """In its query frame a point is the center of a pixel of its part, at the pixel's depth."""
    part, query = sequence.state.track_part, sequence.state.track_query
    assert part is not None and query is not None
    at = image[query, np.arange(len(query))]
    pixel = np.rint(np.nan_to_num(at)).astype(np.int64)
    size = np.array([sequence.meta.width, sequence.meta.height])
    checks = [check("track: begins at a pixel", at - pixel, _PIXELS, "px",
                    lambda i: f"point {i // 2}"),
              check_share("track: begins in the image", ((pixel < 0) | (pixel >= size)).any(1), 0,
                          lambda i: f"point {i}")]
    if not all(c.ok for c in checks):
        return checks
    for t in np.unique(query).tolist():
        now = np.flatnonzero(query == t)
        frame, (u, v) = decode_frame(sequence, t), pixel[now].T
        flat = v * sequence.meta.width + u
        names = [f"point {i} {frame.name(int(p))}" for i, p in zip(now, flat, strict=True)]
        checks.append(check_share("track: begins on its part", frame.part[flat] != part[now], 0,
                                  names.__getitem__))
        gap = np.abs(frame.depth[flat] - z[t, now])
        checks.append(check("track: begins on the surface", np.maximum(0, gap - frame.unit / 2),
                            0.02 * frame.unit + 1e-6 * float(z[t, now].max(initial=0.0)), "m",
                            names.__getitem__))
        checks += _steps(frame, image[:, now], flat, names)
    return checks


def _steps(
    frame: VerifiedFrame, image: Array, flat: NDArray[np.int64], names: list[str]
) -> list[CheckResult]:
    """Flow at the pixels [N] of a query frame, forward and back, is the step of the tracks
    [T N 2]; this also holds where surfaces deform.
    """
    sequence, t, checks = frame.sequence, frame.t, list[CheckResult]()
    steps = [(t + 1, sequence.flow, t)] if t + 1 < sequence.meta.frames else []
    steps += [(t - 1, sequence.flow_backward, t - 1)] if t > 0 else []
    for other, stack, number in steps:
        if stack is None:
            continue
        flow = stack[number].reshape(-1, 2)[flat].astype(np.float64)
        step = image[other] - image[t]
        both = np.isfinite(flow).all(axis=1) & np.isfinite(step).all(axis=1)
        error = np.where(both, np.linalg.norm(flow - step, axis=1), 0.0)
        checks.append(check("track: goes with the flow", error, FLOW, "px", names.__getitem__))
    return checks


def _numbers(kind: str, part: NDArray[np.int64], sequence: Sequence) -> CheckResult:
    alien = (part < 1) | (part > len(sequence.meta.part_names))
    return check(f"{kind}: part numbers", alien, 0, "points")


def _in_parts(sequence: Sequence, part: NDArray[np.int64], world: Array) -> Array:
    """[T N 3] m: points [T N 3] in the frames of their parts."""
    pose = np.linalg.inv(sequence.state.world_from_part)[:, part - 1]
    return np.einsum("tnij,tnj->tni", pose[..., :3, :3], world) + pose[..., :3, 3]


def _still(kind: str, local: Array, rigid: NDArray[np.bool_]) -> CheckResult:
    moved = np.linalg.norm(local - local[:1], axis=-1)[:, rigid]
    return check(f"{kind}: rides on its part", moved, METRES, "m",
                 lambda i: f"frame {i // max(int(rigid.sum()), 1)}")


def _projection(kind: str, sequence: Sequence, world: Array, image: Array | None
                ) -> tuple[list[CheckResult], Array]:
    """The image [T N 2] is that of the world [T N 3]; and depth [T N] m."""
    s = sequence.state
    assert image is not None
    cam = np.einsum("tij,tnj->tni", s.cam_from_world[:, :3, :3], world)
    cam += s.cam_from_world[:, None, :3, 3]
    z = cam[..., 2]
    uv = cam @ s.intrinsics[:2].T / z[..., None]
    known, n = np.isfinite(image).all(axis=-1), max(world.shape[1], 1)
    error = np.where(known, np.linalg.norm(image - uv, axis=-1), 0.0)
    return [check(f"{kind}: image of the world", error, _PIXELS, "px",
                  lambda i: f"frame {i // n} point {i % n}"),
            check_share(f"{kind}: known where it should be", known != (z > 0), 0,
                  lambda i: f"frame {i // n} point {i % n}")], z


def _around(sequence: Sequence, t: int, image: Array | None, part: NDArray[np.int64]
            ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], PixelBlock]:
    """Whether each point is in the image [N], is at its border [N], and the pixels around it."""
    assert image is not None
    frame = decode_frame(sequence, t)
    uv = np.clip(np.nan_to_num(image[t], nan=-1e6), -1e6, 1e6).T
    out = frame.beyond_border(uv)
    return out < 0, np.abs(out) < _PIXELS, frame.around(uv, part)
