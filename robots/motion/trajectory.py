"""How joints move over time: a smooth random motion that stays within every limit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ..geometry import Array, apply
from ..model import ArticulatedModel, JointType, deform_visual, forward_kinematics

_SINES = 3  # half-waves in the speed: at most 1.5 cycles in a sequence
_UNEVENNESS = 1.5  # the speed leaves its mean by up to this share of it; above 1 it may turn back
_UNLIMITED_SLIDE = 0.5  # m to each side of zero where a prismatic joint has no limits
_SMALLEST_SHARE = 0.2  # of the model's size: joints that move less are not scored by default
_SMALLEST_SLIDE = 0.03  # m; less than this does not count as visible motion (docs: observability)


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Joint positions over time; truth and estimate are this one type."""

    times: Array
    """[T] s."""
    positions: Array
    """[T J] rad or m, one column per joint."""


@dataclass(frozen=True)
class MotionRanges:
    """How far and how fast the scored joints of a random motion move."""

    total: tuple[float, float] = (np.deg2rad(10.0), np.deg2rad(70.0))
    """rad: smallest and largest displacement of a revolute joint over the sequence."""
    total_prismatic: tuple[float, float] = (0.1, 0.9)
    """The same of a prismatic joint, as a share of its range; at least 3 cm where that fits."""
    max_step: float = np.deg2rad(6.0)
    """rad between two frames; for a prismatic joint scaled with the total."""
    fps: float = 30.0

    @classmethod
    def from_degrees(
        cls, total: tuple[float, float], total_prismatic: tuple[float, float], max_step: float,
        fps: float,
    ) -> MotionRanges:
        """Return ranges whose `total` and `max_step` are given in degrees."""
        low, high = np.radians(total).tolist()
        return cls((low, high), total_prismatic, float(np.radians(max_step)), fps)


def sample_trajectory(
    model: ArticulatedModel, scored: Sequence[str], frames: int, ranges: MotionRanges | None = None,
    *, rng: np.random.Generator,
) -> JointTrajectory:
    """Draw a smooth motion of all independent joints of a model.

    Scored joints move with a random sign. Their speed varies about its mean with low-frequency
    sines, whose amplitude is what `ranges.max_step` leaves. The displacement is smaller where the
    frames or the range of a joint do not allow more. Other joints keep a random position.

    Positions stay within the limits of the joints and, where these are wider than a full turn or
    missing, within half a turn (prismatic: 0.5 m) of zero. Each joint takes the same number of
    draws, so scoring another joint leaves the rest unchanged.

    """
    ranges = ranges or MotionRanges()
    if frames < 1:
        raise ConfigError(f"a sequence needs at least 1 frame, not {frames}")
    moving = set(joint_indices(model, scored).tolist())
    low, high = np.array(
        [joint_window(model, j) for j in range(len(model.joint_names))]).reshape(-1, 2).T
    paths, shares = np.zeros((frames, len(low))), np.zeros(len(low))
    for j, kind in enumerate(model.joint_types):
        if kind is JointType.PRISMATIC:
            least, most = (share * (high[j] - low[j]) for share in ranges.total_prismatic)
            amount = max(least, min(_SMALLEST_SLIDE, most)), most
            step = ranges.max_step * most / max(ranges.total[1], 1e-12)
        else:
            amount, step = ranges.total, ranges.max_step
        paths[:, j] = _displacement(frames, amount, step, rng, j in moving)
        shares[j] = rng.random()
    paths *= np.minimum(1.0, (high - low) / np.maximum(np.ptp(paths, axis=0), 1e-300))
    first, last = low - paths.min(axis=0), high - paths.max(axis=0)
    positions = np.clip(first + shares * (last - first) + paths, low, high)
    return JointTrajectory(np.arange(frames) / ranges.fps, positions)


def retract_slides(
    model: ArticulatedModel, scored: Sequence[str], trajectory: JointTrajectory
) -> JointTrajectory:
    """Return the motion with the prismatic joints that are not scored at rest.

    Rest is zero, or the limit nearest to it. If they rest already, the result is `trajectory`.
    """
    slides = np.array([kind is JointType.PRISMATIC and name not in scored
                       for kind, name in zip(model.joint_types, model.joint_names, strict=True)])
    rest = np.clip(0.0, model.limits[:, 0], model.limits[:, 1])
    positions = np.where(slides, rest, trajectory.positions)
    if np.array_equal(positions, trajectory.positions):
        return trajectory
    return JointTrajectory(trajectory.times, positions)


def _displacement(frames: int, total: tuple[float, float], max_step: float,
                  rng: np.random.Generator, moves: bool) -> Array:
    """[T] since frame 0; no step exceeds `max_step`, by construction.

    The displacement of a joint that does not move is zero after the same number of draws.
    """
    steps = frames - 1
    reach = max_step * steps
    high = min(total[1], reach)
    low = total[0] if total[0] <= high else high * total[0] / max(total[1], 1e-12)
    amount = rng.uniform(min(low, high), high) * (-1.0, 1.0)[rng.integers(2)]
    heights = rng.standard_normal(_SINES)
    phases = rng.uniform(0.0, 2.0 * np.pi, _SINES)
    unevenness = rng.random()
    if steps == 0 or not moves:
        return np.zeros(frames)
    k = np.arange(1, _SINES + 1)
    u = (np.arange(steps) + 0.5) / steps
    waves = np.sin(np.pi * k * u[:, None] + phases) @ (heights / k)
    waves -= waves.mean()  # so that the total is not touched
    largest = float(np.abs(waves).max())
    room = reach / max(abs(amount), 1e-12) - 1.0
    swing = unevenness * min(room, _UNEVENNESS)
    speed = 1.0 + (swing / largest * waves if largest > 1e-9 else 0.0 * waves)
    return np.concatenate([[0.0], np.cumsum(amount / steps * speed)])


def joint_window(model: ArticulatedModel, joint: int) -> tuple[float, float]:
    """Lowest and highest position (rad or m) that a random motion of the joint may take."""
    low, high = (float(x) for x in model.limits[joint])
    prismatic = model.joint_types[joint] is JointType.PRISMATIC
    half = _UNLIMITED_SLIDE if prismatic else float(np.pi)
    if high - low <= 2.0 * half or (prismatic and np.isfinite(high - low)):
        return low, high
    center = min(max(0.0, low + half), high - half)
    return center - half, center + half


def base_outward(model: ArticulatedModel) -> NDArray[np.int64]:
    """[J] all independent joints, those nearest to the base first."""
    depth = np.zeros(len(model.parent), np.int64)
    for p, parent in enumerate(model.parent):
        depth[p] = (depth[parent] if parent >= 0 else 0) + bool(model.joint[p] >= 0)
    return np.lexsort((model.joint_child, depth[model.joint_child])).astype(np.int64)


def joint_indices(model: ArticulatedModel, names: Sequence[str]) -> NDArray[np.int64]:
    """Indices of independent joints, from the base outward whatever the order of the names.

    Raises ConfigError that lists the joints if a name is not among them.
    """
    for name in names:
        if name not in model.joint_names:
            raise ConfigError(f"{model.name} has no joint {name!r} of its own; there are "
                               f"{', '.join(model.joint_names) or 'none'}")
    return np.array([j for j in base_outward(model) if model.joint_names[j] in names], np.int64)


def default_scored_joints(model: ArticulatedModel, n: int = 3) -> tuple[str, ...]:
    """The first n joints from the base outward whose motion one can hope to see.

    Left out, unless nothing else is there: joints whose moving parts are small beside the model
    (wheels, casters, fingertips), and joints that cannot move. Joints that move nothing visible
    are never scored.
    """
    boxes: dict[int, list[Array]] = {}
    poses = forward_kinematics(model, np.clip(0.0, model.limits[:, 0], model.limits[:, 1]))
    for visual in model.visuals:
        if visual.deforms:
            corners, _ = deform_visual(visual, poses, None, model.morph_weights)
        else:
            low, high = visual.vertices.min(0), visual.vertices.max(0)
            corners = np.stack(np.meshgrid(*np.stack([low, high], 1)), -1).reshape(-1, 3)
            corners = apply(poses[visual.part], corners)
        boxes.setdefault(visual.part, []).append(corners)

    def size(parts: Iterable[int]) -> float:
        """Diagonal of the box around what these parts show, m."""
        points = [box for p in parts for box in boxes.get(int(p), [])]
        return float(np.linalg.norm(np.ptp(np.concatenate(points), axis=0))) if points else 0.0

    names: list[str] = []
    hidden: list[str] = []
    whole = size(boxes)
    for j in base_outward(model):
        driven = np.flatnonzero(model.joint == j)  # with the parts that mimic it
        moved = np.any([model.subtree(int(p)) for p in driven], axis=0)
        extent = size(np.flatnonzero(moved))
        low, high = joint_window(model, int(j))
        good = extent >= _SMALLEST_SHARE * whole and high > low
        if extent > 0:
            (names if good else hidden).append(model.joint_names[j])
        if len(names) == n:
            break
    return tuple((names or hidden)[:n])
