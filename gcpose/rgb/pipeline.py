"""GC-Pose from plain video: the stages of the paper (Fig. 2) without depth.

Parts and motion come from flow under the chain, first between few frames, then over all of them
(Sec. 3.2 and 3.3); bundle adjustment with every point's unknown depth makes them agree (Sec. 3.4).
Scale cannot be seen, and nothing here depends on it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ...errors import GcbenchError
from ...renderer.types import Estimate, Observation
from ...robots.geometry import Array
from ..chain import Known, screws_of
from ..images import Depth, Flow, Footage, footage
from .points import Rays, places
from .search import search_rays
from .tracker import Guess

# of standard deviations: 10 on three arms, times 1.5 as their points became 300 instead of 130
_CALIBRATION, _FLOOR = 15.0, np.radians(0.4)
_CLUELESS = 1.0  # standard deviation of a displacement that nothing was seen of, rad or m
_STRIDE = 2  # px between those whose part is looked up


def estimate_rgb(
    observation: Observation, known: Known, flow: Flow, depth: Depth | None
) -> Estimate | None:
    """Sec. 3.2 to 3.4 on one sequence; None where nothing is seen to move.

    Raises GcbenchError if pixels are not square.
    """
    rgb, k = observation.rgb, observation.intrinsics
    if rgb is None or len(rgb) < 2:
        return None
    if not np.isclose(k[0, 0], k[1, 1], rtol=1e-3):
        raise GcbenchError(f"gcpose on rgb needs square pixels, not focal lengths {k[0, 0]:g} and "
                           f"{k[1, 1]:g} px; resize the images first")
    given = flow if observation.flow is None else observation.flow
    seen = footage(rgb, k, given, depth, observation.part)
    if seen is None:
        return None
    far = distance(known, seen)
    known = replace(known, base=standing(observation, seen))
    guess = search_rays(seen, scaled(known, 1 / far))
    if guess is None:
        return None
    angle = np.where(known.prismatic, far * guess.state.angle, guess.state.angle)
    sigma = deviations(guess)
    if not (np.isfinite(angle).all() and np.isfinite(sigma).all()):
        return None
    screw = None if known.line is None else screws_of(known.line, known.prismatic)
    part = parts(seen, guess, rgb.shape[:3])
    return Estimate(angle, screw, part, sigma)


def distance(known: Known, seen: Footage) -> float:
    """How far away the object is, if its axes tell; else 1."""
    if known.line is None or known.prismatic.all():
        return 1.0
    v, u = np.nonzero(seen.moving[0])
    k = seen.intrinsics
    ray = np.array([(u.mean() - k[0, 2]) / k[0, 0], (v.mean() - k[1, 2]) / k[1, 1], 1.0])
    found: list[float] = []
    for line in known.line[~known.prismatic]:  # where each axis passes the line of sight
        l, foot = line[:3], np.cross(line[:3], line[3:])
        across = ray - l * (l @ ray)
        found.append(float(across @ foot / max(1e-6, across @ across)))
    return float(np.clip(np.median(found), 0.05, 100.0))


def standing(observation: Observation, seen: Footage) -> Array | None:
    """[3] at depth 1, where a machine of several joints stands: at the world's origin, as far as
    that is known and near what moves. Known axes say more: folded arms may hide where they begin.
    """
    world, parent = observation.cam_from_world, observation.parents
    if world is None or observation.axis_line is not None:
        return None
    if len(parent) < 2 or np.any(parent != np.arange(-1, len(parent) - 1)):
        return None
    origin = world[:3, 3]
    if origin[2] <= 0:
        return None
    v, u = np.nonzero(seen.moving.any(axis=0))
    at = (seen.intrinsics @ origin)[:2] / origin[2]
    away = np.hypot(u - at[0], v - at[1]).min()
    return origin / origin[2] if away < max(np.ptp(u), np.ptp(v)) else None


def scaled(known: Known, by: float) -> Known:
    """The same joints in another unit of length."""
    if known.line is None:
        return known
    line = known.line.copy()
    line[~known.prismatic, 3:] *= by
    return replace(known, line=line)


def deviations(guess: Guess) -> Array:
    """[T J] standard deviations that two thirds of the errors lie within."""
    out = np.zeros_like(guess.state.angle)
    out[1:] = np.minimum(np.hypot(_CALIBRATION * guess.deviation(), _FLOOR), _CLUELESS)
    return out


def parts(seen: Footage, guess: Guess, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """[T H W] labels: those of the nearest points, which are moved from the nearest key frame."""
    out = np.zeros(shape, np.uint8)
    rays: Rays = guess.rays
    at = places(guess.state, rays, seen.intrinsics)
    left, top = seen.corner
    height, width = seen.moving.shape[1:]
    keys = np.unique(rays.frame)
    for t in range(seen.frames):
        key = keys[np.abs(keys - t).argmin()]
        mine = rays.frame == key
        v, u = np.nonzero(seen.moving[t, ::_STRIDE, ::_STRIDE])
        if not (mine.any() and len(u)):
            continue
        _, nearest = KDTree(at[mine, t]).query(np.stack([u, v], axis=1) * _STRIDE)
        small = np.zeros((height // _STRIDE + 1, width // _STRIDE + 1), np.uint8)
        small[v, u] = rays.label[mine][nearest]
        full = small.repeat(_STRIDE, axis=0).repeat(_STRIDE, axis=1)[:height, :width]
        out[t, top : top + height, left : left + width] = full * seen.moving[t]
    return out
