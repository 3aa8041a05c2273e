"""Alternative solutions where two neighboring axes are parallel.

The total turn of two parallel joints is well determined, its distribution only by the place of the
second hinge. With the motion of the outer part fixed, each place for that hinge determines what the
first joint does: it moves the hinge to where the outer part moves it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...robots.geometry import Array, apply, inverse
from ..chain import Articulation
from .settings import RgbSettings


def parallel_joints(state: Articulation, settings: RgbSettings) -> list[int]:
    """Return the joints whose axis is parallel to that of the next joint."""
    cosine = np.einsum("jc,jc->j", state.twist[:-1, :3], state.twist[1:, :3])
    return np.flatnonzero(np.abs(cosine) >= settings.parallel_cosine).tolist()


def candidate_feet(
    state: Articulation, joint: int, hinge: Array, places: Array, most: int
) -> Array:
    """Return places [F 3] of a joint's axis if the next joint's axis is at `hinge` [3].

    The first of `places` [P 3], and the `most` places whose distance to the hinge changes least as
    the hinge moves.
    """
    axis = state.twist[joint, :3]
    apart = hinge_path(state, joint, hinge) - places[:, None]
    apart -= (apart @ axis)[..., None] * axis
    radius = np.linalg.norm(apart, axis=2)
    uneven = np.ptp(radius, axis=1)
    best = np.argsort(uneven[1:], kind="stable")[:most]
    return places[np.concatenate([[0], 1 + best])]


def hinge_path(state: Articulation, joint: int, hinge: Array) -> Array:
    """Return the path [T 3] of `hinge` [3] on the part behind the next joint, in the frame of the
    part before the joint."""
    motion = state.motions(len(state.angle))
    before = inverse(motion[:, state.parent[joint] + 1])
    return apply(before @ motion[:, joint + 2], hinge[None])[:, 0]


def keep_total_turn(
    state: Articulation, joint: int, hinge: Array, foot: Array, settings: RgbSettings
) -> Articulation | None:
    """Return the articulation with a joint's axis through `foot` [3] and the next through `hinge`.

    The motion of the part behind both stays the same as far as it can. None where the two axes are
    too close.
    """
    axis = state.twist[joint, :3]
    arm = hinge_path(state, joint, hinge) - foot
    arm -= (arm @ axis)[:, None] * axis
    start = hinge - foot
    start -= (start @ axis) * axis
    if np.linalg.norm(start) < settings.min_axis_distance * np.linalg.norm(hinge):
        return None
    turn = np.unwrap(np.arctan2(np.cross(start, arm) @ axis, arm @ start))
    angle, twist = state.angle.copy(), state.twist.copy()
    sign = _sign(state, joint)
    total = angle[:, joint] + sign * angle[:, joint + 1]
    angle[:, joint] = turn - turn[0]
    angle[:, joint + 1] = sign * (total - angle[:, joint])
    twist[joint, 3:] = np.cross(foot, axis)
    twist[joint + 1, 3:] = np.cross(hinge, twist[joint + 1, :3])
    return replace(state, angle=angle, twist=twist)


def redistribute(state: Articulation, joint: int, share: float) -> Articulation:
    """Return the articulation in which a joint makes `share` of its and the next joint's turn."""
    angle, sign = state.angle.copy(), _sign(state, joint)
    total = angle[:, joint] + sign * angle[:, joint + 1]
    angle[:, joint] = share * total
    angle[:, joint + 1] = sign * (1 - share) * total
    return replace(state, angle=angle)


def _sign(state: Articulation, joint: int) -> float:
    """1 if a joint's axis and the next one's have the same direction, -1 if opposite ones."""
    return float(np.sign(state.twist[joint, :3] @ state.twist[joint + 1, :3]))
