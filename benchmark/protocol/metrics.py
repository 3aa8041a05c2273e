"""Errors of one sequence, as the protocol defines them: pure functions of arrays.

T frames, J scored joints from the base outward, angles in rad and lengths in m unless a function
says otherwise. Revolute joints (continuous ones too) and prismatic ones are never mixed in a mean.

Names in `Result.metric`, a line for each joint (error's unit is deg or m):

    error                the error at a frame, from frame 1 on
    final_error          at the last frame: the headline
    mean_error           mean over frames 1 .. T-1
    step_error           of the motion from frame to frame, mean over the steps
    displacement         the true one at the last frame, absolute: what holding still would score
    covered              1, or 0 if there is no finite estimate
    sigma                at the last frame, where the method gives standard deviations (deg or m)
    within_sigma         1 if the error at the last frame is at most sigma
    within_sigma_frames  the same as a share of frames 1 .. T-1
    axis_direction       angle between the estimated and the true axis, deg, where one is returned
    axis_distance        of the estimated axis from the joint, m (revolute)

and a line for the whole sequence: seconds, seconds_per_frame, peak_memory (MiB), part_miou.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array

PCP_DEGREES = (1.0, 2.0, 5.0, 10.0)
"""A joint is correct if its error is at most so many degrees; prismatic: so many centimetres
(with a lever of half a metre, 5 deg are 4.4 cm)."""
PCP5 = PCP_DEGREES.index(5.0)
"""Position of the headline threshold."""
MAX_DISPLACEMENT = 1e6
"""rad or m; a larger estimate is not a number that means anything, and counts as missing."""
_TINY = 1e-12
Sign = Literal["given", "screw", "best"]


def pcp_thresholds(unit: str) -> tuple[float, ...]:
    """Return the thresholds of PCP in a unit: PCP_DEGREES (deg), or as many cm (m)."""
    return tuple(d / 100.0 for d in PCP_DEGREES) if unit == "m" else PCP_DEGREES


def wrap(angle: Array) -> Array:
    """The same angle in [-pi, pi). Any shape, rad; not even rounded where it is there already."""
    inside = (angle >= -np.pi) & (angle < np.pi)
    return np.where(inside, angle, (angle + np.pi) % (2.0 * np.pi) - np.pi)


def covered(displacement: Array | None, joints: int) -> NDArray[np.bool_]:
    """[J] whether the estimate [T J] is finite in every frame; False if there is none."""
    if displacement is None:
        return np.zeros(joints, bool)
    with np.errstate(invalid="ignore"):
        good = np.abs(displacement) <= MAX_DISPLACEMENT  # NaN is not
    return np.asarray(good.all(0), bool)


def no_motion_where_missing(displacement: Array | None, truth: Array) -> Array:
    """[T J] the estimate, with zeros for a joint that is not finite in every frame."""
    if displacement is None:
        return np.zeros_like(truth)
    return np.where(covered(displacement, truth.shape[1]), displacement, 0.0)


def difference(estimate: Array, truth: Array, prismatic: NDArray[np.bool_]) -> Array:
    """[T J] estimate - truth, both [T J] rad or m; wrapped for angles, not for prismatic [J]."""
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
    """One sign [J] for the whole sequence, +1 or -1, and how it was decided.

    estimate, truth [T J] finite; screws [J 6] in the camera frame at frame 0. "given": the
    method's knowledge includes axes, so the sign is theirs. "screw": -1 where the returned
    direction opposes the true one. "best": no (finite, non-zero) axis is returned, so the sign
    with the smaller error summed over frames. There is no permutation.
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
    """[J] whether a returned screw [J 3|6] is finite and has a direction."""
    usable = np.isfinite(screw) & (np.abs(np.nan_to_num(screw)) <= MAX_DISPLACEMENT)
    safe = np.where(usable, screw, 0.0)
    return usable.all(1) & (np.linalg.norm(safe[:, :3], axis=1) > _TINY)


def errors(
    estimate: Array, truth: Array, prismatic: NDArray[np.bool_], sign: NDArray[np.float64]
) -> Array:
    """[T J] |wrap(sign * estimate - truth)|, rad (without wrap: m, where prismatic [J])."""
    return np.abs(difference(sign * estimate, truth, prismatic))


def step_errors(
    estimate: Array, truth: Array, prismatic: NDArray[np.bool_], sign: NDArray[np.float64]
) -> Array:
    """[T-1 J] the error of the motion from each frame to the next, rad or m."""
    return np.abs(difference(np.diff(sign * estimate, axis=0), np.diff(truth, axis=0), prismatic))


def over_frames(values: Array) -> Array:
    """[J] mean of [T J] over frames 1 .. T-1: at frame 0 there is nothing to estimate."""
    return values[1:].mean(0) if len(values) > 1 else values.mean(0)


def axis_direction_error(screw: Array, true_screw: Array) -> Array:
    """[J] rad in [0, pi/2], between the directions of screws [J 6], whichever way they point.

    NaN where the returned direction is not finite or is zero. By the arctangent: the arccosine of
    a rounded 1.0000000000000002 is NaN.
    """
    found, true = screw[:, :3], true_screw[:, :3]
    known = has_axis(screw[:, :3])
    found = np.where(known[:, None], found, true)
    across = np.linalg.norm(np.cross(found, true), axis=1)
    angle = np.arctan2(across, np.abs((found * true).sum(1)))
    return np.where(known, angle, np.nan)


def axis_distance(screw: Array, true_screw: Array, origin: Array) -> Array:
    """[J] m, from the joint to the estimated axis.

    screw, true_screw [J 6] (l, m = p x l) of revolute joints, l of any length; the joint is the
    true axis' point nearest to `origin` [J 3], the origin of the part that it moves. (The least
    distance of two lines would be zero for almost any wrong axis that is not parallel.)
    NaN where the returned axis is not finite or has no direction.
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
    """[T J] 1 where error <= sigma (both [T J], one unit), else 0; NaN where sigma is no standard
    deviation (NaN or negative)."""
    with np.errstate(invalid="ignore"):
        return np.where(sigma >= 0, (error <= sigma).astype(np.float64), np.nan)


def part_iou(
    estimate: NDArray[np.uint8], truth: NDArray[np.uint8], joints: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels [J] of the intersection and of the union of label j = 1..J in one image [H W]."""
    counts = np.bincount(
        truth.ravel().astype(np.int64) * (joints + 1) + estimate.ravel(),
        minlength=(joints + 1) ** 2,
    ).reshape(joints + 1, joints + 1)
    same = np.diag(counts)
    return same[1:], (counts.sum(0) + counts.sum(1) - same)[1:]


def mean_iou(intersection: NDArray[np.int64], union: NDArray[np.int64]) -> float:
    """Mean over parts [J] of intersection / union, summed over frames; parts that neither the
    truth nor the estimate shows are left out, NaN if that leaves none."""
    shown = union > 0
    return float((intersection[shown] / union[shown]).mean()) if shown.any() else float("nan")
