"""What is believed of any articulated object before it is seen to move; weak beside the images."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from ...robots.geometry import Array
from .articulation import Articulation
from .settings import ChainSettings


@dataclass(frozen=True)
class Normal:
    """Normal equations of an articulation: unknowns are k*J displacements, then the axes'."""

    matrix: Array
    vector: Array


@dataclass(frozen=True)
class Hinges:
    """Where joints are believed to be: an axis passes near where its part begins."""

    point: Array
    """[J 3] m"""
    slack: float
    """Standard deviation of the distance, m."""


def smoothness(angle: Array, last: int, settings: ChainSettings) -> Normal:
    """Prior on the displacements of frames 1..last: joints do not jump, and do not jerk."""
    matrix = smooth_matrix(last, angle.shape[1], settings.acceleration_sigma, settings.step_sigma)
    return Normal(matrix, -matrix @ angle[1 : last + 1].reshape(-1))


@cache
def smooth_matrix(last: int, joints: int, acceleration: float, step: float) -> Array:
    """[last*J last*J] of that prior; it does not depend on the displacements."""
    first = np.eye(last) - np.eye(last, k=-1)
    second = (first @ first)[1:]  # angle[t+1] - 2 angle[t] + angle[t-1], angle[0] = 0
    along = second.T @ second / acceleration**2 + first.T @ first / step**2
    return np.kron(along, np.eye(joints))


def closeness(state: Articulation, basis: tuple[Array, ...], hinges: Hinges) -> Normal:
    """Prior on the axes' unknowns: a hinge should stay where it is when its joint turns."""
    sizes = [b.shape[1] for b in basis]
    matrix, vector = np.zeros((sum(sizes), sum(sizes))), np.zeros(sum(sizes))
    at = 0
    for twist, b, point, prismatic in zip(
        state.twist, basis, hinges.point, state.prismatic, strict=True
    ):
        if b.shape[1] and not prismatic:
            offset = from_axis(twist, point)
            moved = b[3:, :2]  # the axis' slides; its turning hardly changes the distance
            here = slice(at, at + 2)
            matrix[here, here] += moved.T @ moved / hinges.slack**2
            vector[here] += moved.T @ offset / hinges.slack**2
        at += b.shape[1]
    return Normal(matrix, vector)


def from_axis(twist: Array, point: Array) -> Array:
    """[... 3] from the axes of turns [... 6] to points [... 3], by the shortest way."""
    l, moment = twist[..., :3], twist[..., 3:]
    away = point - np.cross(l, moment)
    return away - l * (l * away).sum(axis=-1, keepdims=True)
