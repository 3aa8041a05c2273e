"""Jumps between solutions where two neighbouring axes are parallel.

What two parallel joints turn together is well determined, how they share it only through where the
second one's hinge is. So with the motion of the part behind both held, each place for that hinge
says what the first joint does: it takes the hinge to where the outer part takes it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...robots.geometry import Array, apply, inverse
from ..chain import Articulation

_FEET = 3  # places of the first axis for each
_NEAREST = 0.03  # of the distance to the camera: closer to the first axis, a hinge says nothing


def feet(state: Articulation, joint: int, hinge: Array, places: Array) -> Array:
    """[F 3] where a joint's axis may be if the next one's is at `hinge` [3]: the first of `places`
    [P 3], and those whose distance to the hinge changes least as it moves."""
    axis = state.twist[joint, :3]
    apart = path(state, joint, hinge) - places[:, None]
    apart -= (apart @ axis)[..., None] * axis
    radius = np.linalg.norm(apart, axis=2)
    uneven = np.ptp(radius, axis=1)
    best = np.argsort(uneven[1:], kind="stable")[:_FEET]
    return places[np.concatenate([[0], 1 + best])]


def path(state: Articulation, joint: int, hinge: Array) -> Array:
    """[T 3] where the part behind the next joint takes `hinge` [3], seen from before the joint."""
    motion = state.motions(len(state.angle))
    before = inverse(motion[:, state.parent[joint] + 1])
    return apply(before @ motion[:, joint + 2], hinge[None])[:, 0]


def shared(
    state: Articulation, joint: int, along: float, hinge: Array, foot: Array
) -> Articulation | None:
    """The articulation with a joint's axis through `foot` [3], the next one's through `hinge` [3]
    and the same motion behind both, as far as it can be; None where the two are too close."""
    axis = state.twist[joint, :3]
    arm = path(state, joint, hinge) - foot
    arm -= (arm @ axis)[:, None] * axis
    start = hinge - foot
    start -= (start @ axis) * axis
    if np.linalg.norm(start) < _NEAREST * np.linalg.norm(hinge):
        return None
    turn = np.unwrap(np.arctan2(np.cross(start, arm) @ axis, arm @ start))
    angle, twist = state.angle.copy(), state.twist.copy()
    together = angle[:, joint] + np.sign(along) * angle[:, joint + 1]
    angle[:, joint] = turn - turn[0]
    angle[:, joint + 1] = np.sign(along) * (together - angle[:, joint])
    twist[joint, 3:] = np.cross(foot, axis)
    twist[joint + 1, 3:] = np.cross(hinge, twist[joint + 1, :3])
    return replace(state, angle=angle, twist=twist)
