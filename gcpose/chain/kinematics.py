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

from ...robots.geometry import Array, se3
from .kernels import (
    fill_bases,
    fill_derivatives,
    fill_displaced,
    fill_motions,
    take_moved,
)


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
    fill_displaced(flat, se3.exp(by).reshape(-1, 4, 4), prismatic, out)
    return out.reshape(twist.shape)
