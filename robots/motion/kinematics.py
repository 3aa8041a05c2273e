"""Joint angles of a chain about known axes, fitted to the rotations of its parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array, rotation_about, se3


@dataclass(frozen=True)
class ChainAxes:
    """The axes of a chain's J joints at frame 0, in the camera frame."""

    direction: Array
    """[J 3] unit."""
    prismatic: NDArray[np.bool_]
    """[J]"""
    parent: NDArray[np.int64]
    """[J] the joint that carries each joint, lower than its own index; -1 for none."""


def fit_chain_angles(
    axes: ChainAxes, rotation: Array, information: Array, since: Array, start: Array
) -> Array:
    """Return the angles [J] rad whose rotations fit measured ones best: Gauss-Newton on SO(3).

    `rotation` [J 3 3] of each part is in the camera frame, since the chain had the angles `since`
    [J] rad; `information` [J 3 3] is in 1/rad^2. `start` [J] rad is the first iterate, in which
    the angles of prismatic joints stay.
    """
    joints = len(axes.parent)
    before = chain_rotations(axes, since)
    angle = start.copy()
    for _ in range(10):
        now = chain_rotations(axes, angle)
        hessian, gradient = 1e-9 * np.eye(joints), np.zeros(joints)
        error = se3.so3_log(rotation @ before @ now.swapaxes(1, 2))
        for j in range(joints):
            jacobian = np.zeros((3, joints))
            i = j
            while i >= 0:
                carrier = now[axes.parent[i]] if axes.parent[i] >= 0 else np.eye(3)
                jacobian[:, i] = 0.0 if axes.prismatic[i] else carrier @ axes.direction[i]
                i = axes.parent[i]
            hessian += jacobian.T @ information[j] @ jacobian
            gradient += jacobian.T @ information[j] @ error[j]
        step = np.linalg.solve(hessian, gradient)
        angle = angle + step
        if np.abs(step).max() < 1e-9:
            break
    return angle


def chain_rotations(axes: ChainAxes, angle: Array) -> Array:
    """Return the rotation [J 3 3] of each part since frame 0, for angles [J] rad."""
    out = np.empty((len(axes.parent), 3, 3))
    for j, parent in enumerate(axes.parent):
        rotation = out[parent] if parent >= 0 else np.eye(3)
        turn = np.eye(3) if axes.prismatic[j] else rotation_about(axes.direction[j], angle[j])
        out[j] = rotation @ turn
    return out
