"""Weak priors on any articulated object: smooth motion, and axes near where parts meet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from .articulation import Articulation
from .kernels import fill_hinges
from .kinematics import ancestors
from .settings import ChainSettings


@dataclass(frozen=True)
class HingePrior:
    """Each axis passes near the place where its part begins."""

    point: Array
    """[J 3] m"""
    slack: float
    """Standard deviation of the distance, m"""
    near: Array
    """[J 3] m, a point of each part, about which its axis is turned"""


def locate_hinges(
    points: Array, label: NDArray[np.int64], base: Array, parent: NDArray[np.int64],
    settings: ChainSettings,
) -> Array:
    """Return the place [J 3] where the part of each joint meets its parent part; `base` [3] for
    joints on the base. Points [N 3] have labels [N] 0..J."""
    out = np.empty((len(parent), 3))
    fill_hinges(points, label, base, parent, ancestors(parent), settings.hinge_points,
                settings.hinge_divisor, out)
    return out


def extent(points: Array, settings: ChainSettings) -> float:
    """Return the largest extent of the points [N 3] along a camera axis without outliers, m."""
    low, high = np.quantile(points, [settings.extent_margin, 1 - settings.extent_margin], axis=0)
    return float((high - low).max())


def prior_equations(
    state: Articulation, basis: tuple[Array, ...], hinges: HingePrior, settings: ChainSettings
) -> tuple[Array, Array]:
    """Return matrix [U U] and vector [U] of the priors on the displacements of frames 1.. (small
    first and second differences) and on the axes (Gaussian distances from the hinges)."""
    smooth = smoothness_matrix(len(state.angle) - 1, len(basis), settings.acceleration_sigma,
                               settings.step_sigma)
    at, size = len(smooth), len(smooth) + sum(b.shape[1] for b in basis)
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    matrix[:at, :at] = smooth
    vector[:at] = -smooth @ state.angle[1:].reshape(-1)
    offset = offset_from_axis(state.twist, hinges.point)
    for b, away, prismatic in zip(basis, offset, state.prismatic, strict=True):
        if b.shape[1] and not prismatic:
            moved = b[3:, :2]  # the distance depends on its shift only
            here = slice(at, at + 2)
            matrix[here, here] = moved.T @ moved / hinges.slack**2
            vector[here] = moved.T @ away / hinges.slack**2
        at += b.shape[1]
    return matrix, vector


@cache
def smoothness_matrix(last: int, joints: int, acceleration: float, step: float) -> Array:
    """Return the matrix [last*J last*J] of the prior on displacements."""
    first = np.eye(last) - np.eye(last, k=-1)
    second = (first @ first)[1:]  # angle[t+1] - 2 angle[t] + angle[t-1], angle[0] = 0
    along = second.T @ second / acceleration**2 + first.T @ first / step**2
    return np.kron(along, np.eye(joints))


def offset_from_axis(twist: Array, point: Array) -> Array:
    """Return the shortest vectors [... 3] from revolute axes [... 6] to points [... 3]."""
    l, moment = twist[..., :3], twist[..., 3:]
    away = point - np.cross(l, moment)
    return away - l * (l * away).sum(axis=-1, keepdims=True)
