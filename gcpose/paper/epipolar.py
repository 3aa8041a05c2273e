"""The paper's first stage (Sec. 3.2 and 3.3): parts between two frames by the epipolar constraint.

EM: a pixel belongs to the part whose essential matrix its flow fits best, by the Sampson distance
(the algebraic loss as printed is least where the matrix is least); a part's matrix follows from its
pixels by the eight-point algorithm. With depth the parts' motions follow by PnP.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ...robots.motion import chain_angles, chain_rotations, logarithm
from ..images import order_from_base
from ..numerics import Image
from ..rgb import Spots

_INLIER = 1.0  # px, of a flow that fits a matrix
_WIDTH = 9.0  # px2, beyond which flow is simply wrong
_ROUNDS = 10  # of EM, at most
_FEWEST = 8  # points of a part
_OUT = 2  # parts that may be no joint's: 262 ways for six joints
_OFF = np.radians(3.0)  # from what the chain allows, of a part that is one of it
_SMALL = 5e-3  # cost of a turn by _OFF: of joints that explain a part alike, those that turn less
_REPROJECTED = 3.0  # px, of a point that fits a motion


@dataclass(frozen=True)
class Pair:
    """The N points that two frames match, and their parts."""

    pixel: NDArray[np.int64]
    """[N 2] in the first frame"""
    ray: Array
    """[N 3] of these, at depth 1"""
    there: Array
    """[N 3] in the second"""
    label: NDArray[np.int64]
    """[N] 1..J"""
    essential: Array
    """[J 3 3]: there^T E ray = 0"""


def sampson(essential: Array, ray: Array, there: Array) -> Array:
    """[N] squared distance of matches [N 3] from what an essential matrix [3 3] allows, to first
    order, at focal length 1."""
    line = ray @ essential.T
    back = there @ essential
    below = line[:, 0] ** 2 + line[:, 1] ** 2 + back[:, 0] ** 2 + back[:, 1] ** 2
    return (there * line).sum(axis=1) ** 2 / np.maximum(below, 1e-18)


def pair_of(
    points: Spots, flow: Image, intrinsics: Array, joints: int, base: Array
) -> Pair | None:
    """The parts between a frame and the next, ordered from the base [3] outward; None where too
    few points are seen. `points` are of the first frame, flow [h w 2] leads to the second."""
    if len(points.frame) < _FEWEST:
        return None
    focal = float(intrinsics[0, 0])
    u, v = points.pixel.T
    there = points.ray.copy()
    there[:, :2] += flow[v, u] / focal
    if points.part is not None:
        return given_parts(points, there, joints)
    essential = first_matrices(points.ray, there, joints, _INLIER / focal)
    label = np.zeros(len(u), np.int64)
    for i in range(_ROUNDS):
        square = focal**2 * np.stack([sampson(e, points.ray, there) for e in essential], axis=1)
        before, label = label, points.average(np.minimum(square, _WIDTH)).argmin(axis=1)
        if i and (label == before).all():
            break
        for j in range(joints):
            mine = (label == j) & (square[:, j] < _WIDTH)
            if mine.sum() >= _FEWEST:
                essential[j] = eight_point(points.ray[mine], there[mine])
    rank = order_from_base(points.ray, base[None])
    far = [rank[label == j].mean() if (label == j).any() else 1.0 for j in range(joints)]
    order = np.argsort(far, kind="stable")
    label = 1 + np.argsort(order)[label]
    return Pair(points.pixel, points.ray, there, label, essential[order])


def given_parts(points: Spots, there: Array, joints: int) -> Pair:
    """The same for an oracle's parts."""
    assert points.part is not None
    essential = np.zeros((joints, 3, 3))
    for j in range(joints):
        mine = points.part == j + 1
        if mine.sum() >= _FEWEST:
            essential[j] = first_matrices(points.ray[mine], there[mine], 1, 1e-4)[0]
    return Pair(points.pixel, points.ray, there, points.part, essential)


def first_matrices(ray: Array, there: Array, joints: int, inlier: float) -> Array:
    """[J 3 3] essential matrices by RANSAC, each of what those before it do not explain."""
    out = np.zeros((joints, 3, 3))
    left = np.ones(len(ray), bool)
    cv2.setRNGSeed(0)
    for j in range(joints):
        if left.sum() < _FEWEST:
            left[:] = True
        a, b = (np.ascontiguousarray(x[left, :2]) for x in (ray, there))
        found, fits = cv2.findEssentialMat(a, b, np.eye(3), cv2.RANSAC, 0.999, inlier)
        if np.ndim(found) != 2:  # none was found
            out[j] = eight_point(ray[left], there[left])
            continue
        out[j] = found[:3]
        left[np.flatnonzero(left)[fits.ravel() > 0]] = False
    return out


def eight_point(ray: Array, there: Array) -> Array:
    """[3 3] the essential matrix of at least eight matches [N 3]."""
    found = cv2.findFundamentalMat(ray[:, :2], there[:, :2], cv2.FM_8POINT)[0]
    if np.shape(found) != (3, 3):
        return np.zeros((3, 3))
    u, _, v = np.linalg.svd(found)
    out: Array = u @ np.diag([1.0, 1.0, 0.0]) @ v
    return out


def rotations(pair: Pair) -> list[Array | None]:
    """[3 3] of each part from the first frame to the second; None where it cannot be known."""
    out: list[Array | None] = []
    for j, essential in enumerate(pair.essential):
        mine = pair.label == j + 1
        if mine.sum() < _FEWEST or not essential.any():
            out.append(None)
            continue
        both = cv2.decomposeEssentialMat(essential)[:2]  # half a turn apart
        out.append(np.asarray(max(both, key=np.trace), np.float64))
    return out


def rotations_with_depth(pair: Pair, inverse_depth: Array, focal: float) -> list[Array | None]:
    """The same by PnP, from the points' inverse depths [N]."""
    out: list[Array | None] = []
    points = pair.ray / inverse_depth[:, None]
    cv2.setRNGSeed(0)
    for j in range(len(pair.essential)):
        mine = pair.label == j + 1
        if mine.sum() < _FEWEST:
            out.append(None)
            continue
        here, there = points[mine], np.ascontiguousarray(pair.there[mine, :2])
        good, turn, shift, fits = cv2.solvePnPRansac(
            here, there, np.eye(3), None, reprojectionError=_REPROJECTED / focal
        )
        if not good or np.size(fits) < _FEWEST:
            out.append(None)
            continue
        some = np.asarray(fits, np.int64).ravel()
        turn, _ = cv2.solvePnPRefineLM(here[some], there[some], np.eye(3), None, turn, shift)
        out.append(np.asarray(cv2.Rodrigues(turn)[0], np.float64))
    return out


def orders(joints: int) -> list[NDArray[np.int64]]:
    """The joints [J] that parts in order from the base may have, -1 for a part that is left out,
    at most `_OUT`: two that are found may be of one link, and none of another."""
    out = []
    for n in range(joints, max(0, joints - _OUT - 1), -1):
        for some in combinations(range(joints), n):
            for mine in combinations(range(joints), n):
                out.append(np.full(joints, -1))
                out[-1][list(some)] = mine
    return out


def accumulated(
    pairs: Sequence[Pair | None], steps: Sequence[Sequence[Array | None]], direction: Array,
    parent: NDArray[np.int64], allowed: Sequence[NDArray[np.int64]],
) -> tuple[Array, list[NDArray[np.int64]]]:
    """[T J] displacements from the parts' rotations in the camera frame between frames, and [J]
    the joints of each pair's parts, of those `allowed`.

    direction [J 3] of the axes at frame 0. The chain explains all rotations of a step together,
    each by its share of the points: the turn of a part that is not seen is read off what hangs
    on it.
    """
    joints = len(direction)
    angle, joint = np.zeros((len(steps) + 1, joints)), []
    slides = np.zeros(joints, bool)
    for k, (pair, found) in enumerate(zip(pairs, steps, strict=True)):
        best, angle[k + 1] = np.inf, angle[k]
        joint.append(allowed[0])
        if pair is None:
            continue
        share = np.bincount(pair.label - 1, minlength=joints) / len(pair.label)
        before = chain_rotations(direction, slides, parent, angle[k])
        for order in allowed:
            rotation, weight = np.tile(np.eye(3), (joints, 1, 1)), np.zeros(joints)
            for r, j, much in zip(found, order, share, strict=True):
                if r is not None and j >= 0:
                    rotation[j], weight[j] = r, much
            trust = weight[:, None, None] * np.eye(3)
            now = chain_angles(rotation, trust, direction, slides, parent, angle[k], angle[k])
            turned = chain_rotations(direction, slides, parent, now) @ before.swapaxes(1, 2)
            rest = rotation @ turned.swapaxes(1, 2)
            off = np.array([np.linalg.norm(logarithm(r)) for r in rest])
            cost = weight @ (np.minimum(off, _OFF) / _OFF) ** 2 - weight.sum()
            cost += _SMALL * (((now - angle[k]) / _OFF) ** 2).sum()
            if cost < best:
                best, angle[k + 1], joint[k] = cost, now, order
    return angle, joint
