"""Priors from the declared knowledge of the joints, and the motions that they allow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Observation
from ...robots.geometry import Array, se3
from .kinematics import twists_of


@dataclass(frozen=True)
class JointPriors:
    """The knowledge of J joints; axes are in the camera frame at frame 0."""

    prismatic: NDArray[np.bool_]
    """[J]"""
    parent: NDArray[np.int64]
    """[J] joint before each, -1 for the base"""
    direction: Array | None
    """[J 3] of the axes, if known"""
    line: Array | None
    """[J 6] axes as twists, if known (see kinematics.py)"""
    base: Array | None = None
    """[3] where the chain begins, if known; used on plain video only, at depth 1 if that is not
    measured"""

    @property
    def axis_dof(self) -> int:
        """Free parameters of a revolute axis: 0, 2 (its place) or 4."""
        return 0 if self.line is not None else 2 if self.direction is not None else 4


def joint_priors(observation: Observation) -> JointPriors:
    """Return the knowledge that an observation grants."""
    line, parent = observation.axis_line, observation.parents
    prismatic = np.array([kind == "prismatic" for kind in observation.joint_types], bool)
    if line is not None:
        return JointPriors(prismatic, parent, line[:, :3], twists_of(line, prismatic))
    return JointPriors(prismatic, parent, observation.axis_direction, None)


def scale_axes(known: JointPriors, factor: float) -> JointPriors:
    """Return the same joints in another unit of length."""
    if known.line is None:
        return known
    return replace(known, line=scale_twists(known.line, known.prismatic, factor))


def scale_twists(twist: Array, prismatic: NDArray[np.bool_], factor: float) -> Array:
    """Return twists [J 6] in another unit of length; the direction of a slide has none."""
    lengths = np.where(prismatic[:, None], 1.0, np.repeat([1.0, factor], 3))
    return np.asarray(twist * lengths, np.float64)


def twist_spaces(priors: JointPriors) -> tuple[Array, ...]:
    """Return a basis [6 d] of the twists of each joint.

    Except for known lines, the spaces are the same about any origin.
    """
    eye, out = np.eye(6), []
    for j, prismatic in enumerate(priors.prismatic):
        if priors.direction is None:
            out.append(eye[:, 3:] if prismatic else eye)
            continue
        l = priors.direction[j]
        if prismatic:
            out.append(np.concatenate([np.zeros(3), l])[:, None])
        elif priors.line is not None:
            out.append(priors.line[j][:, None])
        else:
            across = np.linalg.svd(l[None])[2][1:].T
            out.append(np.concatenate([np.concatenate([l, np.zeros(3)])[:, None],
                                       np.concatenate([np.zeros((3, 2)), across])], axis=1))
    return tuple(out)


def twist_about(origin: Array, twist: Array) -> Array:
    """Return twists [... 6] about the camera center as twists about `origin`: v + w x origin."""
    shift = np.eye(4)
    shift[:3, 3] = -origin
    return (se3.adjoint(shift) @ twist[..., None])[..., 0]


def axis_from_twist(
    added: Array, priors: JointPriors, joint: int, hinge: Array, least: float, most: float
) -> tuple[Array, float]:
    """Return the axis [6] and displacement (rad or m) of a joint that makes a twist [6].

    A turn below `least` rad puts the axis through the hinge [3]; else it is at most `most` depths
    of the hinge away.
    """
    w, v = added[:3], added[3:]
    if priors.prismatic[joint]:
        l = v / max(1e-12, float(np.linalg.norm(v)))
        if priors.direction is not None:
            l = priors.direction[joint]
        if not l.any():
            l = np.array([0.0, 0.0, 1.0])
        return np.concatenate([np.zeros(3), l]), float(l @ v)
    if priors.direction is not None:
        l = priors.direction[joint]
    else:
        l = w / max(1e-12, float(np.linalg.norm(w)))
        if not l.any():
            l = np.array([0.0, 0.0, 1.0])
    angle = float(l @ w)
    if priors.line is not None:
        return priors.line[joint].copy(), angle
    across = np.cross(l, hinge)  # velocity of the hinge for a unit turn about the origin
    at_hinge = v + angle * across  # velocity of the hinge: zero if the axis passes through it
    at_hinge -= l * (l @ at_hinge)
    speed = angle if abs(angle) > least else np.copysign(least, angle)
    offset = at_hinge / speed
    far = np.linalg.norm(offset)
    if far > most * hinge[2]:
        offset *= most * hinge[2] / far
    return np.concatenate([l, offset - across]), angle
