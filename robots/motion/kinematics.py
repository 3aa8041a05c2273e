"""Turns of a chain's joints about known axes, from the rotations of its parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array, rotation_about


def chain_angles(
    rotation: Array,
    trust: Array,
    axes: Array,
    prismatic: NDArray[np.bool_],
    parent: NDArray[np.int64],
    since: Array,
    start: Array,
) -> Array:
    """[J] rad: the angles for which the chain's rotations are nearest to the measured ones.

    rotation [J 3 3] of each part in the camera frame since the chain had the angles `since` [J],
    trust [J 3 3] its information, axes [J 3] unit directions at frame 0, parent [J] the joint that
    carries each, -1 for none; from the angles `start`.
    """
    joints = len(axes)
    before = chain_rotations(axes, prismatic, parent, since)
    angle = start.copy()
    for _ in range(10):
        now = chain_rotations(axes, prismatic, parent, angle)
        hessian, gradient = 1e-9 * np.eye(joints), np.zeros(joints)
        for j in range(joints):
            error = logarithm(rotation[j] @ before[j] @ now[j].T)
            jacobian = np.zeros((3, joints))
            i = j
            while i >= 0:
                before_it = now[parent[i]] if parent[i] >= 0 else np.eye(3)
                jacobian[:, i] = 0.0 if prismatic[i] else before_it @ axes[i]
                i = parent[i]
            hessian += jacobian.T @ trust[j] @ jacobian
            gradient += jacobian.T @ trust[j] @ error
        step = np.linalg.solve(hessian, gradient)
        angle = angle + step
        if np.abs(step).max() < 1e-9:
            break
    return angle


def chain_rotations(
    axes: Array, prismatic: NDArray[np.bool_], parent: NDArray[np.int64], angle: Array
) -> Array:
    """[J 3 3] rotation of each part since frame 0, in the camera frame."""
    out = np.empty((len(axes), 3, 3))
    for j, axis in enumerate(axes):
        rotation = out[parent[j]] if parent[j] >= 0 else np.eye(3)
        out[j] = rotation if prismatic[j] else rotation @ rotation_about(axis, angle[j])
    return out


def logarithm(rotation: Array) -> Array:
    """Rotation vector [3] rad of a rotation [3 3] that is no half turn."""
    sine = 0.5 * np.array([
        rotation[2, 1] - rotation[1, 2],
        rotation[0, 2] - rotation[2, 0],
        rotation[1, 0] - rotation[0, 1],
    ])  # fmt: skip
    length = float(np.linalg.norm(sine))
    angle = float(np.arctan2(length, 0.5 * (np.trace(rotation) - 1.0)))
    return sine * (angle / length) if length > 1e-12 else sine
