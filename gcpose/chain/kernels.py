"""Compiled inner loops over the joints of chains (see numerics/compilation.py).

Chains have a few joints and many frames. The overhead of NumPy on each small array is larger than
the sums themselves, and NumPy holds the GIL during that time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..numerics import compiled


@compiled
def fill_motions(twist: Array, angle: Array, parent: NDArray[np.int64], out: Array) -> None:
    """Fill in the motions [S T J+1 4 4], initially zero, of chains [S J 6] with displacements
    [S T J]."""
    each = np.zeros((4, 4))
    for s in range(len(twist)):
        for t in range(angle.shape[1]):
            for a in range(4):
                out[s, t, 0, a, a] = 1.0
            for j in range(len(parent)):
                fill_joint(twist[s, j], angle[s, t, j], each)
                before, after = out[s, t, parent[j] + 1], out[s, t, j + 1]
                for a in range(3):
                    for b in range(4):
                        after[a, b] = before[a, 3] if b == 3 else 0.0
                        for c in range(3):
                            after[a, b] += before[a, c] * each[c, b]
                after[3, 3] = 1.0


@compiled
def fill_joint(twist: Array, angle: float, out: Array) -> None:
    """Fill in the upper three rows of exp(twist angle) for a unit twist without pitch."""
    w, v = twist[:3], twist[3:]
    s, c = np.sin(angle), 1 - np.cos(angle)
    along = w[0] * v[0] + w[1] * v[1] + w[2] * v[2]
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]  # 0 for a prismatic joint
    for a in range(3):
        a1, a2 = (a + 1) % 3, (a + 2) % 3
        for b in range(3):
            out[a, b] = c * w[a] * w[b]
        out[a, a] += 1 - c * square
        out[a, a1] -= s * w[a2]
        out[a, a2] += s * w[a1]
        out[a, 3] = (angle * v[a] + c * (w[a1] * v[a2] - w[a2] * v[a1])
                     + (angle - s) * (w[a] * along - square * v[a]))


@compiled
def add_moved(motion: Array, twist: Array, factor: float, out: Array) -> None:
    """Add a twist [6] of frame b, seen in frame a, times a factor; motion [4 4] is a_from_b."""
    for a in range(3):
        turn, slide = 0.0, 0.0
        for b in range(3):
            turn += motion[a, b] * twist[b]
            slide += motion[a, b] * twist[b + 3]
        out[a] += factor * turn
        out[a + 3] += factor * slide
        a1, a2 = (a + 1) % 3, (a + 2) % 3  # t x (R w), of which this is R w's entry a
        out[a1 + 3] += factor * motion[a2, 3] * turn
        out[a2 + 3] -= factor * motion[a1, 3] * turn


@compiled
def fill_derivatives(
    twist: Array, motion: Array, parent: NDArray[np.int64], moves: NDArray[np.bool_],
    basis: Array, owner: NDArray[np.int64], out: Array,
) -> None:
    """Fill in twists [T J+1 U 6], initially zero, of the parts per unknown.

    The unknowns are the displacements of frames 1.., then those of the axes of joints owner [D] by
    twists basis [D 6]; moves [J+1 J] are the ancestors of each part.
    """
    joints, held = len(parent), (len(motion) - 1) * len(parent)
    one = np.zeros(6)
    for t in range(1, len(motion)):
        for i in range(joints):
            one[:] = 0.0
            add_moved(motion[t, parent[i] + 1], twist[i], 1.0, one)
            for j in range(i + 1, joints + 1):
                if moves[j, i]:
                    out[t, j, (t - 1) * joints + i] = one
        for d in range(len(owner)):
            i = owner[d]
            one[:] = 0.0
            add_moved(motion[t, parent[i] + 1], basis[d], 1.0, one)
            add_moved(motion[t, i + 1], basis[d], -1.0, one)
            for j in range(i + 1, joints + 1):
                if moves[j, i]:
                    out[t, j, held + d] = one


@compiled
def subtract_moved(motion: Array, twist: Array, out: Array) -> None:
    """Subtract twists [T or 1, J+1 U 6], moved by motion [T J+1 4 4], from out [T J+1 U 6]."""
    for t in range(len(motion)):
        for j in range(1, motion.shape[1]):
            here = twist[t if len(twist) > 1 else 0, j]
            for u in range(len(here)):
                if here[u].any():
                    add_moved(motion[t, j], here[u], -1.0, out[t, j, u])


@compiled
def add_normal_equations(
    six: Array, right: Array, g: Array, matrix: Array, vector: Array, scatter: Array
) -> None:
    """Add the equations of parts, six [T J+1 6 6] and right [T J+1 6], to those of U unknowns.

    g [T J+1 U 6] are the twists of the parts per unknown. The outer product of each part's vector
    is added to scatter [U U]. Few unknowns move a part in a frame: only those are visited.
    """
    size = len(vector)
    some, along, each = np.zeros(size, np.int64), np.zeros((size, 6)), np.zeros(size)
    for t in range(len(g)):
        for j in range(1, g.shape[1]):
            many = 0
            for u in range(size):
                if g[t, j, u].any():
                    some[many] = u
                    many += 1
            for p in range(many):
                here = g[t, j, some[p]]
                each[p] = 0.0
                for a in range(6):
                    each[p] += here[a] * right[t, j, a]
                    along[p, a] = 0.0
                    for b in range(6):
                        along[p, a] += six[t, j, a, b] * here[b]
                vector[some[p]] += each[p]
            for p in range(many):
                here = g[t, j, some[p]]
                for q in range(many):
                    product = 0.0
                    for a in range(6):
                        product += here[a] * along[q, a]
                    matrix[some[p], some[q]] += product
                    scatter[some[p], some[q]] += each[p] * each[q]


@compiled
def cross(a: Array, b: Array, out: Array) -> None:
    """Fill in a x b of three numbers each."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] = a[j] * b[k] - a[k] * b[j]


@compiled
def fill_bases(twist: Array, prismatic: bool, near: Array, out: Array) -> None:
    """Fill in bases [N 6 4], initially zero, of axes [N 6] by points near [N 3]; [N 6 2] if
    prismatic."""
    least, foot, turn = np.zeros(3), np.zeros(3), np.zeros(3)
    across, center = np.zeros((2, 3)), np.zeros(3)
    for n in range(len(twist)):
        direction = twist[n, 3:] if prismatic else twist[n, :3]
        least[:] = 0.0
        least[np.argmin(np.abs(direction))] = 1.0
        cross(direction, least, across[0])
        across[0] /= np.sqrt((across[0] ** 2).sum())
        cross(direction, across[0], across[1])
        if prismatic:
            out[n, :3, 0], out[n, :3, 1] = across[0], across[1]
            continue
        cross(direction, twist[n, 3:], foot)
        center[:] = foot + direction * (direction * (near[n] - foot)).sum()
        for d in range(2):
            cross(center, across[d], turn)
            out[n, 3:, d], out[n, :3, d + 2], out[n, 3:, d + 2] = across[d], across[d], turn


@compiled
def fill_displaced(twist: Array, motion: Array, prismatic: bool, out: Array) -> None:
    """Fill in axes [N 6], initially zero, moved by [N 4 4] and normalized to unit screws."""
    for n in range(len(twist)):
        add_moved(motion[n], twist[n], 1.0, out[n])
        if prismatic:
            out[n, :3] = 0.0
            out[n, 3:] /= np.sqrt((out[n, 3:] ** 2).sum())
        else:
            l, v = out[n, :3], out[n, 3:]
            l /= np.sqrt((l * l).sum())
            v -= l * (l * v).sum()


@compiled
def fill_hinges(
    point: Array, label: NDArray[np.int64], base: Array, parent: NDArray[np.int64],
    moves: NDArray[np.bool_], most: int, divisor: int, out: Array,
) -> None:
    """Fill in hinges [J 3]: means of the points that joint j moves and that are nearest to its
    parent's points; where there are none, the parent's hinge or the base [3].

    points [N 3]; at most `most` of each are compared, and one in `divisor` of them is averaged.
    """
    inner, outer = np.zeros(len(point), np.int64), np.zeros(len(point), np.int64)
    for j in range(len(parent)):
        p, before, behind = parent[j], 0, 0
        out[j] = out[p] if p >= 0 else base
        if p < 0:
            continue
        for i in range(len(point)):
            if label[i] > 0 and moves[label[i], j]:
                outer[behind] = i
                behind += 1
            elif label[i] > 0 and moves[p + 1, label[i] - 1]:
                inner[before] = i
                before += 1
        if before == 0 or behind == 0:
            continue
        a, b = min(most, behind), min(most, before)
        apart, some = np.zeros(a), np.zeros(a, np.int64)
        for i in range(a):
            some[i] = outer[int(i * (behind - 1) / max(1, a - 1))]
            x, y, z = point[some[i], 0], point[some[i], 1], point[some[i], 2]
            apart[i] = np.inf
            for k in range(b):
                at = inner[int(k * (before - 1) / max(1, b - 1))]
                dx, dy, dz = point[at, 0] - x, point[at, 1] - y, point[at, 2] - z
                apart[i] = min(apart[i], dx * dx + dy * dy + dz * dz)
        nearest = np.argsort(apart)[: 1 + a // divisor]
        out[j] = 0.0
        for i in nearest:
            out[j] += point[some[i]] / len(nearest)
