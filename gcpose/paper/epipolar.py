"""The paper's first stage (Sec. 3.2 and 3.3): parts between two frames by the epipolar constraint.

EM: a pixel belongs to the part whose essential matrix its flow fits best, by the Sampson distance
(the algebraic loss as printed is least where the matrix is least); a part's matrix follows from its
pixels by the eight-point algorithm (Longuet-Higgins, 1981). With depth the parts' motions follow by
PnP.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, se3
from ...robots.motion import ChainAxes, chain_rotations, fit_chain_angles
from ..images import ImageSettings, geodesic_rank
from ..numerics import Image
from ..rgb import SampledPixels
from .settings import PaperSettings


@dataclass(frozen=True)
class MatchedParts:
    """N points that are matched between two frames, and their parts."""

    pixel: NDArray[np.int64]
    """[N 2] (u, v) in the first frame"""
    ray: Array
    """[N 3] of these, at depth 1"""
    there: Array
    """[N 3] in the second frame, at depth 1"""
    label: NDArray[np.int64]
    """[N] 1..J"""
    essential: Array
    """[J 3 3]: there^T E ray = 0"""


def sampson_distance(essential: Any, ray: Any, there: Any, tiny: float = 1e-18) -> Any:
    """Return the signed Sampson distance [N] of matches [N 3] at focal length 1.

    It is the distance from the nearest match that fits the essential matrix ([3 3] or [N 3 3]), to
    first order (Hartley and Zisserman, Multiple View Geometry, 2nd ed., eq. 11.9). Arguments are
    NumPy arrays or PyTorch tensors; `tiny` bounds the squared denominator.
    """
    line = (essential @ ray[..., None])[..., 0]
    back = (essential.swapaxes(-1, -2) @ there[..., None])[..., 0]
    square = (line[..., :2] ** 2).sum(-1) + (back[..., :2] ** 2).sum(-1)
    return (there * line).sum(-1) / square.clip(min=tiny) ** 0.5


@dataclass(frozen=True)
class PartMatcher:
    """Finds the parts between a frame and the next."""

    focal: float
    """px"""
    joints: int
    settings: PaperSettings
    images: ImageSettings

    def match(self, points: SampledPixels, base: Array, flow: Image) -> MatchedParts | None:
        """Return the matched parts, ordered from the base [3] outward; None with too few points.

        `points` are of the first frame, flow [h w 2] px leads to the second.
        """
        s = self.settings
        if len(points.frame) < s.min_points:
            return None
        u, v = points.pixel.T
        there = points.ray.copy()
        there[:, :2] += flow[v, u] / self.focal
        if points.part is not None:
            return self._match_true_parts(points, there)
        essential = first_matrices(points.ray, there, self.joints, s.inlier / self.focal, s)
        label = np.zeros(len(u), np.int64)
        for i in range(s.max_rounds):
            square = self.focal**2 * np.stack(
                [sampson_distance(e, points.ray, there) ** 2 for e in essential], axis=1)
            cost = points.average(np.minimum(square, s.outlier_cost))
            before, label = label, cost.argmin(axis=1)
            if i and (label == before).all():
                break
            for j in range(self.joints):
                mine = (label == j) & (square[:, j] < s.outlier_cost)
                if mine.sum() >= s.min_points:
                    essential[j] = eight_point(points.ray[mine], there[mine])
        rank = geodesic_rank(points.ray, base[None], self.images)
        far = [rank[label == j].mean() if (label == j).any() else 1.0 for j in range(self.joints)]
        order = np.argsort(far, kind="stable")
        label = 1 + np.argsort(order)[label]
        return MatchedParts(points.pixel, points.ray, there, label, essential[order])

    def _match_true_parts(self, points: SampledPixels, there: Array) -> MatchedParts:
        """The same for an oracle's parts."""
        assert points.part is not None
        s = self.settings
        essential = np.zeros((self.joints, 3, 3))
        for j in range(self.joints):
            mine = points.part == j + 1
            if mine.sum() >= s.min_points:
                essential[j] = first_matrices(
                    points.ray[mine], there[mine], 1, s.oracle_inlier, s)[0]
        return MatchedParts(points.pixel, points.ray, there, points.part, essential)


def first_matrices(
    ray: Array, there: Array, joints: int, inlier: float, settings: PaperSettings
) -> Array:
    """Return essential matrices [J 3 3] by RANSAC, each of the points that those before do not fit.

    `inlier` is the largest distance of a match that fits, at focal length 1.
    """
    out = np.zeros((joints, 3, 3))
    left = np.ones(len(ray), bool)
    cv2.setRNGSeed(0)
    for j in range(joints):
        if left.sum() < settings.min_points:
            left[:] = True
        a, b = (np.ascontiguousarray(x[left, :2]) for x in (ray, there))
        found, fits = cv2.findEssentialMat(a, b, np.eye(3), cv2.RANSAC,
                                          settings.ransac_confidence, inlier)
        if np.ndim(found) != 2:  # none was found
            out[j] = eight_point(ray[left], there[left])
            continue
        out[j] = found[:3]
        left[np.flatnonzero(left)[fits.ravel() > 0]] = False
    return out


def eight_point(ray: Array, there: Array) -> Array:
    """Return the essential matrix [3 3] of at least eight matches [N 3]; zeros if there is none."""
    found = cv2.findFundamentalMat(ray[:, :2], there[:, :2], cv2.FM_8POINT)[0]
    if np.shape(found) != (3, 3):
        return np.zeros((3, 3))
    u, _, v = np.linalg.svd(found)
    out: Array = u @ np.diag([1.0, 1.0, 0.0]) @ v
    return out


def rotations(parts: MatchedParts, settings: PaperSettings) -> list[Array | None]:
    """Return the rotation [3 3] of each part between the frames; None with too few points."""
    out: list[Array | None] = []
    for j, essential in enumerate(parts.essential):
        mine = parts.label == j + 1
        if mine.sum() < settings.min_points or not essential.any():
            out.append(None)
            continue
        both = cv2.decomposeEssentialMat(essential)[:2]  # half a turn apart
        out.append(np.asarray(max(both, key=np.trace), np.float64))
    return out


def rotations_with_depth(
    parts: MatchedParts, inverse_depth: Array, focal: float, settings: PaperSettings
) -> list[Array | None]:
    """Return the same by PnP with the points' inverse depths [N]."""
    out: list[Array | None] = []
    points = parts.ray / inverse_depth[:, None]
    cv2.setRNGSeed(0)
    for j in range(len(parts.essential)):
        mine = parts.label == j + 1
        if mine.sum() < settings.min_points:
            out.append(None)
            continue
        here, there = points[mine], np.ascontiguousarray(parts.there[mine, :2])
        good, turn, shift, fits = cv2.solvePnPRansac(
            here, there, np.eye(3), None, reprojectionError=settings.pnp_inlier / focal
        )
        if not good or np.size(fits) < settings.min_points:
            out.append(None)
            continue
        some = np.asarray(fits, np.int64).ravel()
        turn, _ = cv2.solvePnPRefineLM(here[some], there[some], np.eye(3), None, turn, shift)
        out.append(np.asarray(cv2.Rodrigues(turn)[0], np.float64))
    return out


def joint_orders(joints: int, most: int) -> list[NDArray[np.int64]]:
    """Return the joints [J] that parts in order from the base may belong to.

    At most `most` parts are left out, marked by -1: two parts that are found may be of one link,
    and another link may have none.
    """
    out = []
    for n in range(joints, max(0, joints - most - 1), -1):
        for some in combinations(range(joints), n):
            for mine in combinations(range(joints), n):
                out.append(np.full(joints, -1))
                out[-1][list(some)] = mine
    return out


def accumulate_angles(
    pairs: Sequence[MatchedParts | None], steps: Sequence[Sequence[Array | None]],
    axes: ChainAxes, orders: Sequence[NDArray[np.int64]], settings: PaperSettings,
) -> tuple[Array, list[NDArray[np.int64]]]:
    """Sum up angles from the rotations in the camera frame of the parts of T-1 pairs of frames.

    The chain explains all rotations of a step together, each weighted by its share of the points:
    the turn of a part that is not seen follows from the parts that it carries. No joint slides.
    Returns displacements [T J], rad, and the joints [J] of each pair's parts, of `orders`.
    """
    joints = len(axes.direction)
    angle = np.zeros((len(steps) + 1, joints))
    chosen: list[NDArray[np.int64]] = []
    for k, (pair, found) in enumerate(zip(pairs, steps, strict=True)):
        best, angle[k + 1] = np.inf, angle[k]
        chosen.append(orders[0])
        if pair is None:
            continue
        share = np.bincount(pair.label - 1, minlength=joints) / len(pair.label)
        for order in orders:
            rotation, weight = np.tile(np.eye(3), (joints, 1, 1)), np.zeros(joints)
            for r, j, much in zip(found, order, share, strict=True):
                if r is not None and j >= 0:
                    rotation[j], weight[j] = r, much
            now, cost = _fit_step(rotation, weight, axes, angle[k], settings)
            if cost < best:
                best, angle[k + 1], chosen[k] = cost, now, order
    return angle, chosen


def _fit_step(
    rotation: Array, weight: Array, axes: ChainAxes, before: Array, settings: PaperSettings
) -> tuple[Array, float]:
    """Angles [J] after a step of rotations [J 3 3] with weights [J], and their cost."""
    trust = weight[:, None, None] * np.eye(3)
    now = fit_chain_angles(axes, rotation, trust, before, before)
    at_first, at_last = (chain_rotations(axes, a) for a in (before, now))
    rest = rotation @ (at_last @ at_first.swapaxes(1, 2)).swapaxes(1, 2)
    off = np.linalg.norm(se3.so3_log(rest), axis=-1)
    scale = settings.max_deviation
    cost = weight @ (np.minimum(off, scale) / scale) ** 2 - weight.sum()
    return now, float(cost + settings.turn_cost * (((now - before) / scale) ** 2).sum())
