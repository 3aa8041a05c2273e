"""The Lie groups SO(3) and SE(3), and screws; vectorized over leading axes.

A twist is six numbers `(w, v)`: a point x moves with velocity w x x + v. A revolute screw is the
unit twist `(l, m)` of a line: its direction l and its moment m = p x l for any point p on it.
Turning by theta about it is exp([l, m] theta). A prismatic screw is the direction and zeros (the
dataset's contract), which is why its motion has a function of its own.

Source: Lynch and Park, Modern Robotics (2017), sections 3.2 and 3.3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .transforms import Array, hat, rotation_about, transform

__all__ = [
    "adjoint", "exp", "hat", "left_jacobian", "log", "move_screw", "prismatic_motion",
    "revolute_motion", "so3_exp", "so3_log",
]

_SMALL = 1e-4  # rad; under it series replace the quotients: their error is under 1e-17


def so3_exp(w: ArrayLike) -> Array:
    """The rotation [... 3 3] of a rotation vector w [... 3] rad."""
    k = hat(w)
    sine, versine, _ = _quotients(w)
    return np.eye(3) + sine * k + versine * (k @ k)


def so3_log(rotation: ArrayLike) -> Array:
    """The rotation vector [... 3] rad of a rotation [... 3 3] by less than a half turn."""
    r = np.asarray(rotation, np.float64)
    axis = 0.5 * np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0],
                           r[..., 1, 0] - r[..., 0, 1]], axis=-1)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(r, axis1=-2, axis2=-1) - 1.0))
    small = sine < 1e-12
    return axis * np.where(small, 1.0, angle / np.where(small, 1.0, sine))[..., None]


def left_jacobian(w: ArrayLike) -> Array:
    """J [... 3 3] of w [... 3] rad: exp((w, v)) translates by J v."""
    k = hat(w)
    _, versine, rest = _quotients(w)
    return np.eye(3) + versine * k + rest * (k @ k)


def exp(twist: ArrayLike) -> Array:
    """The rigid motion [... 4 4] of a twist [... 6]."""
    t = np.asarray(twist, np.float64)
    w, v = t[..., :3], t[..., 3:]
    return transform(so3_exp(w), (left_jacobian(w) @ v[..., None])[..., 0])


def log(motion: ArrayLike) -> Array:
    """The twist [... 6] with exp(twist) = motion [... 4 4]; it turns by less than a half turn."""
    m = np.asarray(motion, np.float64)
    w = so3_log(m[..., :3, :3])
    angle = np.linalg.norm(w, axis=-1)
    small = angle < _SMALL
    a = np.where(small, 1.0, angle)
    half = 0.5 * a
    bend = np.where(small, 1 / 12, (1 - half * np.cos(half) / np.sin(half)) / a**2)
    k = hat(w)
    left = np.eye(3) - 0.5 * k + bend[..., None, None] * (k @ k)
    return np.concatenate([w, (left @ m[..., :3, 3, None])[..., 0]], axis=-1)


def adjoint(a_from_b: ArrayLike) -> Array:
    """The matrix [... 6 6] that takes twists of frame b to frame a; a_from_b is [... 4 4]."""
    m = np.asarray(a_from_b, np.float64)
    r, t = m[..., :3, :3], m[..., :3, 3]
    out = np.zeros((*m.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = r
    out[..., 3:, :3] = hat(t) @ r
    return out


def revolute_motion(screw: ArrayLike, angle: ArrayLike) -> Array:
    """exp(screw * angle) [... 4 4]: turn by `angle` [...] rad about the line `screw` [... 6]."""
    s = np.asarray(screw, np.float64)
    l, m = s[..., :3], s[..., 3:]
    r = rotation_about(l, angle)
    point = np.cross(l, m)  # the point of the line that is nearest to the origin
    return transform(r, point - np.einsum("...ij,...j->...i", r, point))


def prismatic_motion(screw: ArrayLike, distance: ArrayLike) -> Array:
    """Shift [... 4 4] by `distance` [...] m along the direction of `screw` [... 6]."""
    s = np.asarray(screw, np.float64)
    return transform(None, s[..., :3] * np.asarray(distance, np.float64)[..., None])


def move_screw(a_from_b: ArrayLike, screw_in_b: ArrayLike, prismatic: ArrayLike = False) -> Array:
    """The screw [... 6] of frame b in frame a. `prismatic` [...] keeps zeros for the moment."""
    m, s = np.asarray(a_from_b, np.float64), np.asarray(screw_in_b, np.float64)
    l = np.einsum("...ij,...j->...i", m[..., :3, :3], s[..., :3])
    moment = np.einsum("...ij,...j->...i", m[..., :3, :3], s[..., 3:])
    moment = moment + np.cross(m[..., :3, 3], l)
    moment = np.where(np.asarray(prismatic, bool)[..., None], 0.0, moment)
    return np.concatenate([l, moment], axis=-1)


def _quotients(w: ArrayLike) -> tuple[Array, Array, Array]:
    """sin(a)/a, (1 - cos(a))/a^2 and (a - sin(a))/a^3 of a = |w|, each [... 1 1]."""
    angle = np.linalg.norm(np.asarray(w, np.float64), axis=-1)[..., None, None]
    small = angle < _SMALL
    a = np.where(small, 1.0, angle)
    square = angle**2
    return (
        np.where(small, 1 - square / 6, np.sin(a) / a),
        np.where(small, 0.5 - square / 24, 0.5 * (np.sin(0.5 * a) / (0.5 * a)) ** 2),
        np.where(small, 1 / 6 - square / 120, (a - np.sin(a)) / a**3),
    )
