"""Joint trajectories, the angles behind observed rotations, and collisions of a moving model."""

from __future__ import annotations

from .collision import CollisionChecker
from .kinematics import chain_angles, chain_rotations, logarithm
from .trajectory import (
    JointTrajectory,
    default_scored_joints,
    drawn_in,
    joint_indices,
    sample_trajectory,
)

__all__ = [
    "CollisionChecker", "JointTrajectory", "chain_angles", "chain_rotations",
    "default_scored_joints", "drawn_in", "joint_indices", "logarithm", "sample_trajectory",
]
