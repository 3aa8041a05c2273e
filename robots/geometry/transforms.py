"""Rigid transforms and rotations, vectorized over leading axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def transform(rotation: ArrayLike | None = None, translation: ArrayLike | None = None) -> Array:
    """Return [... 4 4] of a rotation [... 3 3] and a translation [... 3]; default: identity."""
    r = np.eye(3) if rotation is None else np.asarray(rotation, np.float64)
    t = np.zeros(3) if translation is None else np.asarray(translation, np.float64)
    shape = np.broadcast_shapes(r.shape[:-2], t.shape[:-1])
    out = np.zeros((*shape, 4, 4))
    out[..., :3, :3] = r
    out[..., :3, 3] = t
    out[..., 3, 3] = 1.0
    return out


def inverse(a_from_b: ArrayLike) -> Array:
    """Return b_from_a [... 4 4] of rigid a_from_b [... 4 4]."""
    m = np.asarray(a_from_b, np.float64)
    r = np.swapaxes(m[..., :3, :3], -1, -2)
    return transform(r, -np.einsum("...ij,...j->...i", r, m[..., :3, 3]))


def apply(a_from_b: ArrayLike, points_in_b: ArrayLike) -> Array:
    """Return points [... N 3] of frame b in frame a; a_from_b is [... 4 4]."""
    m, p = np.asarray(a_from_b, np.float64), np.asarray(points_in_b, np.float64)
    return p @ np.swapaxes(m[..., :3, :3], -1, -2) + m[..., None, :3, 3]


def hat(w: ArrayLike) -> Array:
    """Return the skew matrix [... 3 3] of w [... 3]: hat(w) @ x = w x x."""
    w = np.asarray(w, np.float64)
    k = np.zeros((*w.shape[:-1], 3, 3))
    k[..., 0, 1], k[..., 0, 2] = -w[..., 2], w[..., 1]
    k[..., 1, 0], k[..., 1, 2] = w[..., 2], -w[..., 0]
    k[..., 2, 0], k[..., 2, 1] = -w[..., 1], w[..., 0]
    return k


def rotation_about(direction: ArrayLike, angle: ArrayLike) -> Array:
    """Return the rotation [... 3 3] by `angle` [...] rad about a unit `direction` [... 3].

    Rodrigues' formula.
    """
    l = np.asarray(direction, np.float64)
    a = np.asarray(angle, np.float64)[..., None, None]
    k = hat(l)
    return np.eye(3) + np.sin(a) * k + (1.0 - np.cos(a)) * (k @ k)


def rotation_from_rpy(rpy: ArrayLike) -> Array:
    """Return the rotation [... 3 3] of roll, pitch, yaw [... 3] rad: Rz(yaw) Ry(pitch) Rx(roll)."""
    e = np.asarray(rpy, np.float64)
    x, y, z = np.eye(3)
    rx, ry, rz = (rotation_about(np.broadcast_to(d, e.shape), e[..., i])
                  for i, d in enumerate((x, y, z)))
    return rz @ ry @ rx


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """Return the rotation [... 3 3] of unit quaternions [... 4] (x, y, z, w)."""
    x, y, z, w = np.moveaxis(np.asarray(quaternion, np.float64), -1, 0)
    rows = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def quaternion_from_rotation(rotation: ArrayLike) -> Array:
    """Return the unit quaternion [... 4] (x, y, z, w) of a rotation [... 3 3]; its sign is free."""
    from scipy.spatial.transform import Rotation

    r = np.asarray(rotation, np.float64)
    quaternion = Rotation.from_matrix(r.reshape(-1, 3, 3)).as_quat()
    return np.asarray(quaternion, np.float64).reshape(*r.shape[:-2], 4)


def nearest_rotation(linear: ArrayLike) -> Array:
    """Return the rotation [... 3 3] nearest to linear maps [... 3 3], by polar decomposition.

    For a map that mirrors it is the rotation nearest to minus the map.
    """
    m = np.asarray(linear, np.float64)
    sign = np.where(np.linalg.det(m) < 0.0, -1.0, 1.0)[..., None, None]
    u, _, v = np.linalg.svd(sign * m)
    u[..., :, 2] *= np.where(np.linalg.det(u @ v) < 0.0, -1.0, 1.0)[..., None]
    return u @ v
