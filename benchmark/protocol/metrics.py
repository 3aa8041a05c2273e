"""Metrics of the protocol for one sequence, as pure functions of arrays.

T frames, J scored joints from the base outward. Angles are in rad and lengths in m unless stated.
A mean never mixes revolute (or continuous) joints with prismatic joints.

Values of `Result.metric` with one line per joint (errors and sigma in deg or m):

    error                error at one frame, 1 .. T-1
    final_error          error at the last frame: the main metric
    mean_error           mean error over frames 1 .. T-1
    step_error           error of the motion between consecutive frames, mean over the steps
    displacement         absolute true displacement at the last frame: the error of "no motion"
    pixels               fewest visible pixels in a frame of all that the joint moves
    distance             from the camera to the origin of the joint's child part at frame 0, m
    covered              1 if the estimate is finite in every frame, else 0
    sigma                estimated standard deviation at the last frame, if the method returns one
    within_sigma         1 if the error at the last frame is at most sigma, else 0
    within_sigma_frames  share of frames 1 .. T-1 whose error is at most sigma
    reliable             1 if the method says that the last frame can be believed, else 0
    axis_direction       angle between the estimated and the true axis, deg, if an axis is returned
    axis_distance        distance of the estimated axis from the joint, m (revolute joints)

Values with one line per sequence: seconds, seconds_per_frame, peak_memory (MiB), part_miou.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array

PCP_DEGREES = (1.0, 2.0, 5.0, 10.0)
"""Largest errors of a correct joint, deg (revolute) or cm (prismatic). At a lever arm of 0.5 m,
5 deg correspond to 4.4 cm."""
PCP5 = PCP_DEGREES.index(5.0)
"""Index of the main threshold, 5 deg or 5 cm."""
MAX_DISPLACEMENT = 1e6
"""Largest valid estimate, rad or m; a larger one counts as missing."""
_TINY = 1e-12
Sign = Literal["given", "screw", "best"]


def pcp_thresholds(unit: str) -> tuple[float, ...]:
    """Return the PCP thresholds in a unit: PCP_DEGREES for "deg", a hundredth of each for "m"."""
    return tuple(d / 100.0 for d in PCP_DEGREES) if unit == "m" else PCP_DEGREES


def wrap(angle: Array) -> Array:
    """Wrap angles (any shape, rad) to [-pi, pi); return angles in that range bit for bit."""
    inside = (angle >= -np.pi) & (angle < np.pi)
    return np.where(inside, angle, (angle + np.pi) % (2.0 * np.pi) - np.pi)


def is_covered(displacement: Array | None, joints: int) -> NDArray[np.bool_]:
    """Return [J] True where the estimate [T J] is valid in every frame; all False for None."""
    if displacement is None:
        return np.zeros(joints, bool)
    with np.errstate(invalid="ignore"):
        good = np.abs(displacement) <= MAX_DISPLACEMENT  # False for NaN
    return np.asarray(good.all(0), bool)


def fill_missing(displacement: Array | None, truth: Array) -> Array:
    """Return the estimate [T J] with zeros for each joint that is not `covered`."""
    if displacement is None:
        return np.zeros_like(truth)
    return np.where(is_covered(displacement, truth.shape[1]), displacement, 0.0)


def difference(estimate: Array, truth: Array, prismatic: NDArray[np.bool_]) -> Array:
    """Return estimate - truth [T J], rad or m, wrapped for joints that are not prismatic [J]."""
    delta = estimate - truth
    return np.where(prismatic, delta, wrap(delta))


def signs(
    estimate: Array,
    truth: Array,
    prismatic: NDArray[np.bool_],
    axes_known: bool,
    screw: Array | None = None,
    true_screw: Array | None = None,
) -> tuple[NDArray[np.float64], list[Sign]]:
    """Choose the sign of each joint [J], +1 or -1, for the whole sequence, and return its origin.

    "given": the method knows the axes, so the sign is +1. "screw": -1 where the returned direction
    opposes the true one. "best": no axis is returned; the sign with the smaller error, summed over
    frames. Estimate and truth [T J] are finite; screws [J 6] are in the camera frame at frame 0.
    """
    joints = truth.shape[1]
    if axes_known:
        return np.ones(joints), ["given"] * joints
    as_is = np.abs(difference(estimate, truth, prismatic)).sum(0)
    flipped = np.abs(difference(-estimate, truth, prismatic)).sum(0)
    sign, how = np.where(flipped < as_is, -1.0, 1.0), ["best"] * joints
    if screw is not None and true_screw is not None:
        given = has_axis(screw)
        dot = (np.where(given[:, None], screw, 0.0)[:, :3] * true_screw[:, :3]).sum(1)
        sign = np.where(given, np.where(dot < 0, -1.0, 1.0), sign)
        how = ["screw" if g else "best" for g in given]
    return sign, list[Sign](how)  # pyright: ignore[reportArgumentType]


def has_axis(screw: Array) -> NDArray[np.bool_]:
    """Return [J] True where a screw [J 3] or [J 6] is finite and its direction is not zero."""
    usable = np.isfinite(screw) & (np.abs(np.nan_to_num(screw)) <= MAX_DISPLACEMENT)
    safe = np.where(usable, screw, 0.0)
    return usable.all(1) & (np.linalg.norm(safe[:, :3], axis=1) > _TINY)


def errors(
    estimate: Array, truth: Array, prismatic: NDArray[np.bool_], sign: NDArray[np.float64]
) -> Array:
    """Return |wrap(sign * estimate - truth)| [T J], rad; not wrapped, m, where prismatic [J]."""
    return np.abs(difference(sign * estimate, truth, prismatic))


def step_errors(
    estimate: Array, truth: Array, prismatic: NDArray[np.bool_], sign: NDArray[np.float64]
) -> Array:
    """Return the errors [T-1 J] of the motion from each frame to the next, rad or m."""
    return np.abs(difference(np.diff(sign * estimate, axis=0), np.diff(truth, axis=0), prismatic))


def over_frames(values: Array) -> Array:
    """Return the mean [J] of values [T J] over frames 1 .. T-1; frame 0 is zero by definition."""
    return values[1:].mean(0) if len(values) > 1 else values.mean(0)


def axis_direction_error(screw: Array, true_screw: Array) -> Array:
    """Return the unsigned angles [J] between the directions of screws [J 6], rad in [0, pi/2].

    NaN where the estimated direction is not finite or is zero.
    """
    found, true = screw[:, :3], true_screw[:, :3]
    known = has_axis(screw[:, :3])
    found = np.where(known[:, None], found, true)
    across = np.linalg.norm(np.cross(found, true), axis=1)
    angle = np.arctan2(across, np.abs((found * true).sum(1)))
    return np.where(known, angle, np.nan)


def axis_distance(screw: Array, true_screw: Array, origin: Array) -> Array:
    """Return the distances [J], m, from each revolute joint to its estimated axis.

    Screws [J 6] are (l, m = p x l). The joint is the point of the true axis nearest to `origin`
    [J 3], the origin of the child part: the distance of two lines vanishes where they intersect.
    NaN where the estimated axis is not finite or its direction is zero.
    """
    known = has_axis(screw)
    safe = np.where(known[:, None], screw, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    length = np.linalg.norm(safe[:, :3], axis=1, keepdims=True)
    line, moment = safe[:, :3] / length, safe[:, 3:] / length
    true_l, true_m = true_screw[:, :3], true_screw[:, 3:]
    point = np.cross(true_l, true_m)
    joint = point + ((origin - point) * true_l).sum(1, keepdims=True) * true_l
    distance = np.linalg.norm(np.cross(joint - np.cross(line, moment), line), axis=1)
    return np.where(known, distance, np.nan)


def within_sigma(error: Array, sigma: Array) -> Array:
    """Return [T J]: 1 where error <= sigma (equal units), 0 elsewhere, NaN for an invalid sigma."""
    with np.errstate(invalid="ignore"):
        return np.where(sigma >= 0, (error <= sigma).astype(np.float64), np.nan)


def part_iou(
    estimate: NDArray[np.uint8], truth: NDArray[np.uint8], joints: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Count the pixels [J] of intersection and union of the labels 1 .. J in one image [H W]."""
    counts = np.bincount(
        truth.ravel().astype(np.int64) * (joints + 1) + estimate.ravel(),
        minlength=(joints + 1) ** 2,
    ).reshape(joints + 1, joints + 1)
    same = np.diag(counts)
    return same[1:], (counts.sum(0) + counts.sum(1) - same)[1:]


def mean_iou(intersection: NDArray[np.int64], union: NDArray[np.int64]) -> float:
    """Return the mean of intersection / union over the parts [J] with a union; NaN without any."""
    shown = union > 0
    return float((intersection[shown] / union[shown]).mean()) if shown.any() else float("nan")
