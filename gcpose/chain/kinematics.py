"""Forward kinematics of chains by the product of exponentials, and its derivatives.

`parent` [J] is the joint before each, -1 for the base; a joint comes after its parent. Part j + 1
is what joint j moves last, part 0 the base.

A twist is six numbers (w, v): a point x moves with w x x + v. The twist of a revolute joint is its
screw (l, m = p x l), that of a prismatic joint (0, l), so that one formula serves both. All are in
the camera frame at frame 0; the camera is static.

Source: Lynch and Park, Modern Robotics (2017), chapters 4 and 5.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, se3
from .kernels import fill_bases, fill_derivatives, fill_displaced, fill_motions, subtract_moved


def twists_of(screw: Array, prismatic: NDArray[np.bool_]) -> Array:
    """Return the twists [J 6] of the dataset's screws [J 6]; prismatic [J] bool."""
    slide = np.concatenate([np.zeros_like(screw[:, :3]), screw[:, :3]], axis=1)
    return np.where(prismatic[:, None], slide, screw)


def screws_of(twist: Array, prismatic: NDArray[np.bool_]) -> Array:
    """Return the dataset's screws [J 6] of twists [J 6]; prismatic [J] bool."""
    slide = np.concatenate([twist[:, 3:], np.zeros_like(twist[:, 3:])], axis=1)
    return np.where(prismatic[:, None], slide, twist)


def ancestors(parent: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return [J+1 J] which joints move each part."""
    out = np.zeros((len(parent) + 1, len(parent)), bool)
    for j, p in enumerate(parent):
        out[j + 1] = out[p + 1]
        out[j + 1, j] = True
    return out


def part_motions(twist: Array, angle: Array, parent: NDArray[np.int64]) -> Array:
    """Return the motions [... T J+1 4 4] of all parts since frame 0; part 0 is static.

    For axes twist [... J 6] and displacements angle [... T J], T_j = exp(S_i a_i) ... exp(S_j a_j)
    over the ancestors of part j.
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
    """Return twists [T J+1 U 6] of the parts, T_j <- exp(twist) T_j, per unknown.

    The unknowns are the displacements of frames 1.., then the axes by the twists basis[i] [6 d_i].
    Moving axis i by exp(z) changes exp(S a) to exp(z) exp(S a) exp(-z): hence the twist
    (Ad T_p - Ad T_i) z of every part that joint i moves, with p the parent of i.
    """
    owner = np.repeat(np.arange(len(basis)), [b.shape[1] for b in basis])
    rows = np.ascontiguousarray(np.concatenate(basis, axis=1).T)
    unknowns = (len(motion) - 1) * len(twist) + len(owner)
    out = np.zeros((*motion.shape[:2], unknowns, 6))
    moves = ancestors(parent)
    fill_derivatives(np.ascontiguousarray(twist), motion, parent, moves, rows, owner, out)
    return out


def relative_derivatives(derivative: Array, motion: Array, other: Array) -> Array:
    """Return the derivatives [T J+1 U 6] of motions relative to other ones.

    `motion` [T J+1 4 4] is from the others, whose derivatives are `other` [T or 1, J+1 U 6].
    """
    out = derivative.copy()
    subtract_moved(motion, other, out)
    return out


def axis_basis(twist: Array, prismatic: bool, near: Array, axis_dof: int) -> Array:
    """Return twists [... 6 d] that displace axes [... 6].

    `axis_dof` is 0 for none, 2 for shifts across the axis, and 4 for shifts and turns. `near` [3]
    is a point on the part: turns are about its projection onto the axis, which decouples direction
    and position in the normal equations. A prismatic axis has only a direction (d = 2 if
    `axis_dof` is 4).
    """
    if axis_dof == 0 or (prismatic and axis_dof < 4):
        return np.zeros((*twist.shape, 0))
    flat = np.ascontiguousarray(twist).reshape(-1, 6)
    out = np.zeros((*flat.shape, 2 if prismatic else 4))
    fill_bases(flat, prismatic, np.broadcast_to(near, (len(flat), 3)).copy(), out)
    return out[..., :axis_dof].reshape(*twist.shape, -1)


def displace_axis(twist: Array, by: Array, prismatic: bool) -> Array:
    """Return axes [... 6] moved by exp(by [... 6]), normalized to unit directions without pitch."""
    flat = np.ascontiguousarray(twist).reshape(-1, 6)
    out = np.zeros_like(flat)
    fill_displaced(flat, se3.exp(by).reshape(-1, 4, 4), prismatic, out)
    return out.reshape(twist.shape)
