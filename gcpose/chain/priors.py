"""What is known of the joints, and what that leaves of their motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Observation
from ...robots.geometry import Array, se3
from .kinematics import twists_of


@dataclass(frozen=True)
class Known:
    """What a method knows of the joints."""

    prismatic: NDArray[np.bool_]
    """[J]"""
    parent: NDArray[np.int64]
    """[J] (see chain.py)"""
    direction: Array | None
    """[J 3]"""
    line: Array | None
    """[J 6]"""
    base: Array | None = None
    """[3] at depth 1, where the chain begins; not used with depth"""

    @property
    def freedom(self) -> int:
        """Unknowns of a revolute axis."""
        return 0 if self.line is not None else 2 if self.direction is not None else 4


def knowledge(observation: Observation) -> Known:
    """What an observation grants, known axes as twists."""
    line, parent = observation.axis_line, observation.parents
    prismatic = np.array([kind == "prismatic" for kind in observation.joint_types], bool)
    if line is not None:
        return Known(prismatic, parent, line[:, :3], twists_of(line, prismatic))
    return Known(prismatic, parent, observation.axis_direction, None)


def spaces(known: Known) -> tuple[Array, ...]:
    """[6 d] of each joint: the twists it may add, about any origin but for known lines."""
    eye, out = np.eye(6), []
    for j, prismatic in enumerate(known.prismatic):
        if known.direction is None:
            out.append(eye[:, 3:] if prismatic else eye)
            continue
        l = known.direction[j]
        if prismatic:
            out.append(np.concatenate([np.zeros(3), l])[:, None])
        elif known.line is not None:
            out.append(known.line[j][:, None])
        else:
            across = np.linalg.svd(l[None])[2][1:].T
            out.append(np.concatenate([np.concatenate([l, np.zeros(3)])[:, None],
                                       np.concatenate([np.zeros((3, 2)), across])], axis=1))
    return tuple(out)


def about(origin: Array, twist: Array) -> Array:
    """Twists [... 6] about the camera's centre as twists about `origin`: v + w x origin."""
    shift = np.eye(4)
    shift[:3, 3] = -origin
    return (se3.adjoint(shift) @ twist[..., None])[..., 0]


def axis_from(
    added: Array, known: Known, joint: int, hinge: Array, least: float, most: float
) -> tuple[Array, float]:
    """Twist [6] of unit speed and displacement of a joint that adds `added` [6].

    Where it hardly moves (less than `least`), its axis is taken through `hinge` [3]; elsewhere it
    passes within `most` times the hinge's depth.
    """
    w, v = added[:3], added[3:]
    if known.prismatic[joint]:
        l = v / max(1e-12, float(np.linalg.norm(v)))
        if known.direction is not None:
            l = known.direction[joint]
        if not l.any():
            l = np.array([0.0, 0.0, 1.0])
        return np.concatenate([np.zeros(3), l]), float(l @ v)
    if known.direction is not None:
        l = known.direction[joint]
    else:
        l = w / max(1e-12, float(np.linalg.norm(w)))
        if not l.any():
            l = np.array([0.0, 0.0, 1.0])
    angle = float(l @ w)
    if known.line is not None:
        return known.line[joint].copy(), angle
    across = np.cross(l, hinge)  # velocity of the hinge for a unit turn about the origin
    at_hinge = v + angle * across  # what the hinge does: zero if the axis meets it
    at_hinge -= l * (l @ at_hinge)
    speed = angle if abs(angle) > least else np.copysign(least, angle)
    offset = at_hinge / speed
    far = np.linalg.norm(offset)
    if far > most * hinge[2]:
        offset *= most * hinge[2] / far
    return np.concatenate([l, offset - across]), angle
