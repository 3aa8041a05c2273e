"""Joints as the estimator sees them: screws, the motions they make, and their derivatives.

Each joint is carried by another or by the base: parent [J] is which, -1 for the base, and a joint
stands behind what carries it. Part j + 1 is what joint j is the last to move, part 0 the base.

A twist is six numbers (w, v): a point x moves with w x x + v. A revolute joint's twist is its
screw (l, m = p x l); a prismatic joint's is (0, l), so that one formula serves both. Everything is
in the camera frame at frame 0, which the static camera keeps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, transform
from .kernels import (
    fill_bases,
    fill_derivatives,
    fill_displaced,
    fill_motions,
    take_moved,
)


def cross_matrix(v: Array) -> Array:
    """[... 3 3] with cross_matrix(v) @ x = v x x."""
    k = np.zeros((*v.shape[:-1], 3, 3))
    k[..., 0, 1], k[..., 0, 2] = -v[..., 2], v[..., 1]
    k[..., 1, 0], k[..., 1, 2] = v[..., 2], -v[..., 0]
    k[..., 2, 0], k[..., 2, 1] = -v[..., 1], v[..., 0]
    return k


def adjoint(a_from_b: Array) -> Array:
    """[... 6 6]: twists of frame b in frame a."""
    r, t = a_from_b[..., :3, :3], a_from_b[..., :3, 3]
    out = np.zeros((*a_from_b.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = r
    out[..., 3:, :3] = cross_matrix(t) @ r
    return out


def exponential(twist: Array) -> Array:
    """[... 4 4] rigid motion exp(twist) of any twist [... 6]."""
    w, v = twist[..., :3], twist[..., 3:]
    angle = np.linalg.norm(w, axis=-1)
    small = angle < 1e-9
    a = np.where(small, 1.0, angle)[..., None, None]
    k = cross_matrix(w)
    s, c = np.sin(a), np.cos(a)
    eye, flat = np.eye(3), small[..., None, None]
    r = np.where(flat, eye + k, eye + s / a * k + (1 - c) / a**2 * (k @ k))
    left = np.where(flat, eye + 0.5 * k, eye + (1 - c) / a**2 * k + (a - s) / a**3 * (k @ k))
    return transform(r, np.einsum("...ij,...j->...i", left, v))


def logarithm(motion: Array) -> Array:
    """Twists [... 6] with exponential(twist) = motion [... 4 4], turns below pi."""
    r, t = motion[..., :3, :3], motion[..., :3, 3]
    axis = 0.5 * np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0],
                           r[..., 1, 0] - r[..., 0, 1]], axis=-1)
    sine, cosine = np.linalg.norm(axis, axis=-1), 0.5 * (np.trace(r, axis1=-2, axis2=-1) - 1)
    angle = np.arctan2(sine, cosine)
    small = angle < 1e-4
    a, s = np.where(small, 1.0, angle), np.where(sine < 1e-12, 1.0, sine)
    w = axis * np.where(small, 1.0, a / s)[..., None]
    k = cross_matrix(w)
    bend = np.where(small, 1 / 12, 1 / a**2 - (1 + np.cos(a)) / (2 * a * np.where(small, 1.0, s)))
    left = np.eye(3) - 0.5 * k + bend[..., None, None] * (k @ k)
    return np.concatenate([w, (left @ t[..., None])[..., 0]], axis=-1)


def twists_of(screw: Array, prismatic: NDArray[np.bool_]) -> Array:
    """Twists [J 6] of the dataset's screws [J 6]; prismatic [J] bool."""
    slide = np.concatenate([np.zeros_like(screw[:, :3]), screw[:, :3]], axis=1)
    return np.where(prismatic[:, None], slide, screw)


def screws_of(twist: Array, prismatic: NDArray[np.bool_]) -> Array:
    """The dataset's screws [J 6] of twists [J 6]."""
    slide = np.concatenate([twist[:, 3:], np.zeros_like(twist[:, 3:])], axis=1)
    return np.where(prismatic[:, None], slide, twist)


def carriers(parent: NDArray[np.int64]) -> NDArray[np.bool_]:
    """[J+1 J] which joints move each part."""
    out = np.zeros((len(parent) + 1, len(parent)), bool)
    for j, p in enumerate(parent):
        out[j + 1] = out[p + 1]
        out[j + 1, j] = True
    return out


def part_motions(twist: Array, angle: Array, parent: NDArray[np.int64]) -> Array:
    """[... T J+1 4 4]: where part j's points of frame 0 are at frame t; part 0 stands still.

    twist [... J 6], angle [... T J]: T_j = exp(S_i a_i) ... exp(S_j a_j), of what carries it.
    """
    shape = (*angle.shape[:-1], twist.shape[-2] + 1, 4, 4)
    chains = np.ascontiguousarray(twist).reshape(-1, *twist.shape[-2:])
    out = np.zeros((len(chains), *shape[-4:]))
    fill_motions(chains, np.ascontiguousarray(angle).reshape(len(chains), *angle.shape[-2:]),
                 parent, out)
    return out.reshape(shape)


def derivatives(
    twist: Array, motion: Array, parent: NDArray[np.int64], basis: tuple[Array, ...]
) -> Array:
    """[T J+1 U 6]: twists of the parts (T_j <- exp(twist) T_j) per unknown: displacements of
    frames 1.., then axes by the twists basis[i] [6 d_i].

    Moving axis i by exp(z) turns exp(S a) into exp(z) exp(S a) exp(-z): hence
    (Ad T_p - Ad T_i) z on every part that i moves, p what carries it.
    """
    owner = np.repeat(np.arange(len(basis)), [b.shape[1] for b in basis])
    rows = np.ascontiguousarray(np.concatenate(basis, axis=1).T)
    unknowns = (len(motion) - 1) * len(twist) + len(owner)
    out = np.zeros((*motion.shape[:2], unknowns, 6))
    moves = carriers(parent)
    fill_derivatives(np.ascontiguousarray(twist), motion, parent, moves, rows, owner, out)
    return out


def relative(derivative: Array, motion: Array, other: Array) -> Array:
    """Derivatives [T J+1 U 6] of what moves parts from where others [T or 1, J+1 U 6] have them,
    motion [T J+1 4 4] apart."""
    out = derivative.copy()
    take_moved(motion, other, out)
    return out


def axis_basis(twist: Array, prismatic: bool, near: Array, freedom: int) -> Array:
    """[... 6 d] twists that displace axes [... 6]: 0 none, 2 across itself, 4 across and turning.

    `near` [3] is a point by the part: the turning is about the foot of its perpendicular, so that
    direction and position stay apart in the normal equations. A prismatic axis has only a
    direction (d = 2 where freedom is 4).
    """
    if freedom == 0 or (prismatic and freedom < 4):
        return np.zeros((*twist.shape, 0))
    flat = np.ascontiguousarray(twist).reshape(-1, 6)
    out = np.zeros((*flat.shape, 2 if prismatic else 4))
    fill_bases(flat, prismatic, np.broadcast_to(near, (len(flat), 3)).copy(), out)
    return out[..., :freedom].reshape(*twist.shape, -1)


def displace_axis(twist: Array, by: Array, prismatic: bool) -> Array:
    """The twists [... 6] of axes after exp(by): again unit directions, again without pitch."""
    flat = np.ascontiguousarray(twist).reshape(-1, 6)
    out = np.zeros_like(flat)
    fill_displaced(flat, exponential(by).reshape(-1, 4, 4), prismatic, out)
    return out.reshape(twist.shape)
