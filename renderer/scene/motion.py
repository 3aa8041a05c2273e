"""Motion of a model in a sequence: random joint motion, or one of its animations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import ConfigError
from ...robots.geometry import Array, apply, hull_vertices
from ...robots.model import Animation, ArticulatedModel, JointType, forward_kinematics
from ...robots.motion import (
    CollisionChecker,
    JointTrajectory,
    MotionRanges,
    retract_slides,
    sample_trajectory,
)
from .config import RenderConfig
from .posed_model import PosedModel, pose_parts

NO_ANIMATION = "none"
"""`--animation none`: the joints move even if the model has an animation."""


@dataclass(frozen=True)
class Motion:
    """Motion of a model, and the height of its floor."""

    trajectory: JointTrajectory
    posed: PosedModel
    floor: float
    """z of the floor, m"""
    touches: bool
    """Whether the model touches itself or the floor in a frame."""
    record: Mapping[str, Any]
    """Drawn values in addition to the joint motion, for `meta.json`."""

    @property
    def world_from_part(self) -> Array:
        """[T P 4 4]"""
        return self.posed.world_from_part


def find_animation(model: ArticulatedModel, name: str) -> Animation | None:
    """Return the animation with a name, the first one for "", or None if the joints move.

    Raises ConfigError with the existing names.
    """
    if name == NO_ANIMATION or (not name and not model.animations):
        return None
    for animation in model.animations:
        if not name or animation.name == name:
            return animation
    names = ", ".join(repr(a.name) for a in model.animations) or "none in this model"
    raise ConfigError(f"--animation {name!r}: there are {names} (and none: the joints move)")


def remove_joints(model: ArticulatedModel) -> ArticulatedModel:
    """Return the model without joints: an animation moves it, so that no joint is scored."""
    parts = len(model.parent)
    return replace(
        model, joint_names=(), joint_child=np.zeros(0, np.int64), limits=np.zeros((0, 2)),
        joint=np.full(parts, -1), part_joint_types=(JointType.FIXED,) * parts,
    )


class MotionSampler:
    """Sampler of motions for one model and configuration."""

    def __init__(
        self, model: ArticulatedModel, scored: tuple[str, ...], config: RenderConfig,
        fixed_motion: Animation | JointTrajectory | None,
    ) -> None:
        """Without a `fixed_motion`, motions are drawn at random."""
        self.model, self.scored, self.config = model, scored, config
        self.fixed_motion = fixed_motion
        rigid = tuple(v for v in model.visuals if not v.deforms)
        self._deforms = len(rigid) < len(model.visuals)
        # A bending skin intersects itself: only rigid surfaces are checked for collisions.
        checked = replace(model, visuals=rigid) if self._deforms else model
        moves_joints = fixed_motion is None or isinstance(fixed_motion, JointTrajectory)
        self.checker = CollisionChecker(checked) if rigid and moves_joints else None
        self._hulls = _hulls(replace(model, visuals=rigid))
        self._replayed: Motion | None = None

    def draw(self, rng: np.random.Generator) -> Motion:
        """Draw a motion with the number of frames of the configuration."""
        if isinstance(self.fixed_motion, JointTrajectory):
            self._replayed = self._replayed or self._motion(self.fixed_motion)
            return self._replayed
        if self.fixed_motion is not None:
            return self._play(rng, self.fixed_motion)
        config, ranges = self.config, self.config.randomization.motion
        trajectory = sample_trajectory(
            self.model, self.scored, config.frames, rng=rng,
            ranges=MotionRanges.from_degrees(
                ranges.total, ranges.total_prismatic, ranges.max_step, ranges.fps),
        )
        motion = self._motion(trajectory)
        if motion.touches:  # probably a rack that is out while its door is closed
            inside = retract_slides(self.model, self.scored, trajectory)
            motion = motion if inside is trajectory else self._motion(inside)
        return motion

    def _motion(self, trajectory: JointTrajectory) -> Motion:
        world_from_part = _freeze_static(forward_kinematics(self.model, trajectory.positions))
        posed = pose_parts(self.model, world_from_part)
        floor, touches = np.inf, False
        if self.checker:
            floor = self.checker.groups.ground_height(world_from_part)
        if self._deforms:
            floor = min(floor, self._lowest(posed))
        if self.checker:
            touches = self.checker.first_contact(world_from_part, floor) is not None
        return Motion(trajectory, posed, floor, touches, {})

    def outline(self, posed: PosedModel, frames: slice = slice(None)) -> Array:
        """Return world points [N 3] m that bound the model in some of its frames."""
        poses = posed.world_from_part[frames]
        numbers = range(*frames.indices(len(posed.world_from_part)))
        poses = poses[0] if len(poses) == 1 else poses
        rigid = [apply(poses[..., part, :, :], points).reshape(-1, 3)
                 for part, points in self._hulls]
        moved = [hull_vertices(np.concatenate([v for v, _ in posed.surfaces(t)]))
                 for t in numbers if posed.deforming]
        return np.concatenate([*rigid, *moved])

    def _play(self, rng: np.random.Generator, animation: Animation) -> Motion:
        """Play the animation at its own speed from a random time; a short one is looped."""
        fps, frames = self.config.randomization.motion.fps, self.config.frames
        times = np.arange(frames) / fps
        spare = animation.duration - times[-1]
        start = float(rng.random() * (spare if spare >= 0 else animation.duration))
        state = animation.at(animation_times(times, start, animation.duration))
        world_from_part = _freeze_static(state.world_from_part)
        posed = PosedModel(self.model, replace(state, world_from_part=world_from_part))
        record = {"name": animation.name, "start": start, "duration": animation.duration}
        trajectory = JointTrajectory(times, np.zeros((frames, 0)))
        return Motion(trajectory, posed, self._lowest(posed), False, {"animation": record})

    def _lowest(self, posed: PosedModel) -> float:
        return float(self.outline(posed)[:, 2].min())


def _freeze_static(world_from_part: Array) -> Array:
    """Return poses [T P 4 4] in which a part at rest is exactly constant: its flow is zero."""
    still = np.ptp(world_from_part, axis=0).max(axis=(1, 2)) < 1e-12
    return np.where(still[:, None, None], world_from_part[:1], world_from_part)


def animation_times(times: Array, start: float, duration: float) -> Array:
    """Return times [T] s in an animation from `start` on; looped if shorter than the sequence."""
    at = start + times - times[0]
    loops = duration > 0 and at[-1] > duration * (1 + 1e-9)
    return np.mod(at, duration) if loops else np.minimum(at, duration)


def _hulls(model: ArticulatedModel) -> list[tuple[int, Array]]:
    """Return the convex hull vertices [N 3] m of each part in its frame, for bounding boxes."""
    by_part: dict[int, list[Array]] = {}
    for visual in model.visuals:
        by_part.setdefault(visual.part, []).append(visual.vertices)
    return [(part, hull_vertices(np.concatenate(by_part[part]))) for part in sorted(by_part)]
