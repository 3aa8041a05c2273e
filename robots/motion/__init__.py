"""Joint trajectories, the angles behind observed rotations, and collisions of a moving model."""

from __future__ import annotations

from .collision import CollisionChecker
from .kinematics import ChainAxes, chain_rotations, fit_chain_angles
from .trajectory import (
    JointTrajectory,
    MotionRanges,
    default_scored_joints,
    joint_indices,
    joint_window,
    retract_slides,
    sample_trajectory,
)

__all__ = [
    "ChainAxes", "CollisionChecker", "JointTrajectory", "MotionRanges", "chain_rotations",
    "default_scored_joints", "fit_chain_angles", "joint_indices", "joint_window", "retract_slides",
    "sample_trajectory",
]
