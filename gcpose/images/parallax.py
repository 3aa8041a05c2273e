"""Rotation and translation of a camera by features that stand still, each at its own depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...robots.geometry import Array, nearest_rotation
from ..numerics import cauchy_weight, truncated_cost
from .features import FeatureTracks

# All distances are in standard deviations of a feature's place.
_MOVES = 4.0  # Distance from the homography in a frame at which a feature may start the search.
_SEEDS = 100
_SEED_FRAMES, _SHARED_FRAMES = 0.4, 0.25  # Shares of the frames.
_STEADY = 0.95  # Above it, a path never turns back.
_MOVING_GROUPS = 4
_LIMIT = 9.0  # Squared distance beyond which all cost the same.
_UNEXPLAINED, _EXPLAINED = 4.0, 2.0  # Mean squared distances before and after a seed explains it.
_ALONG = 0.2  # Share of a distance that may differ: the camera also moves along its axis.
_MIN_FEATURES = 4  # that a seed explains
_SCALES = np.repeat([6.0, 4.0, 3.0, 2.5], 5)  # of the robust weights
_MAX_INVERSE_DEPTH = 10.0
_FIT, _FIT_SHARE, _FIT_FRAMES = 3.0, 0.7, 4  # What stands still fits in most of its frames.
_STEP = 0.005  # Root mean square of the translations, so that inverse depths are about 1.
_DAMPING = 1e-6


@dataclass(frozen=True)
class Parallax:
    """A camera that turns and moves before N features, of which some stand still."""

    rotation: Array
    """[T-1 3 3] from frame 0"""
    translation: Array
    """[T-1 3], in units of the depth"""
    inverse_depth: Array
    """[N] in frame 0"""
    distance: Array
    """[T-1 N] of each feature from where it would be, px; NaN where it is not found"""
    still: NDArray[np.bool_]
    """[N]"""
    explained: int
    """Number of features whose parallax one feature explains: few may show another motion"""


@dataclass(frozen=True)
class _Sightings:
    """Where N features are seen in T frames, as rays of depth 1."""

    ray: Array
    """[N 3] in frame 0"""
    seen: Array
    """[T-1 N 2] in the others"""
    found: NDArray[np.bool_]
    """[T-1 N]"""
    deviation: Array
    """[N]"""
    share: Array
    """[N] of the weight that each has"""


def find_parallax(
    tracks: FeatureTracks, homography: Array, intrinsics: Array
) -> Parallax | None:
    """Return the motion of the camera, or None where no features move otherwise than homographies
    [T-1 3 3] of most of the background.

    Before a camera that moves by t, what stands still is off by its inverse depth times the same
    image of t (plane and parallax: Irani and Anandan, 1996). So a feature that is off tells how
    others are, up to a factor each. The one that explains most starts the bundle adjustment of all
    rotations, translations and inverse depths.
    """
    focal = intrinsics[0, 0]
    off = tracks.offsets(homography)
    scaled = np.where(tracks.found[..., None], off / tracks.deviation[:, None], 0.0)
    seed = _find_seed(scaled, tracks.found)
    if seed is None:
        return None
    first, factor, explained = seed
    rotation = np.stack([nearest_rotation(h / np.cbrt(np.linalg.det(h)))
                         for h in np.linalg.inv(intrinsics) @ homography @ intrinsics])
    translation = np.zeros((len(off), 3))
    translation[:, :2] = np.where(tracks.found[:, first, None], off[:, first] / focal, 0.0)
    views = _Sightings(_rays(intrinsics, tracks.start), _rays(intrinsics, tracks.end)[..., :2],
                       tracks.found, tracks.deviation / focal,
                       _shares(scaled, tracks.found, explained))
    inverse_depth = factor * tracks.deviation / tracks.deviation[first]
    rotation, translation, inverse_depth = _adjust(rotation, translation, inverse_depth, views)
    place = _project(_move(rotation, translation, inverse_depth, views.ray))
    distance = focal * np.linalg.norm(views.seen - place, axis=2)
    distance[~tracks.found] = np.nan
    fits = (distance < _FIT * tracks.deviation).sum(axis=0)
    still = fits >= np.maximum(_FIT_SHARE * tracks.found.sum(axis=0),
                               min(_FIT_FRAMES, len(distance)))
    if _is_behind(inverse_depth[still]):
        translation, inverse_depth = -translation, -inverse_depth
    return Parallax(rotation, translation, inverse_depth, distance, still, explained)


def _rays(intrinsics: Array, at: Array) -> Array:
    """Return the rays [... 3] of pixels [... 2], at depth 1."""
    ones = np.ones((*at.shape[:-1], 1))
    return np.asarray(np.concatenate([at, ones], axis=-1) @ np.linalg.inv(intrinsics).T)


def _find_seed(off: Array, found: NDArray[np.bool_]) -> tuple[int, Array, int] | None:
    """Return the feature that explains the distances `off` [T N 2] of most others from the
    homographies, their factors [N], and how many it explains; None if none explains several.

    Features that an object takes along are in proportion as well. But a joint moves in one
    direction, and a hand turns back: so groups that move steadily are left out.
    """
    found = found.copy()
    for _ in range(_MOVING_GROUPS):
        seed = _best_seed(off * found[..., None], found)
        if seed is None:
            return None
        first, factor, explained = seed
        weight = factor * (explained | (np.arange(len(factor)) == first))
        if _steadiness((weight[:, None] * off * found[..., None]).sum(axis=1),
                       (weight**2 * found).sum(axis=1)) < _STEADY:
            return first, factor, int(explained.sum())
        found[:, weight != 0] = False
    return None


def _steadiness(moved: Array, weight: Array) -> float:
    """Return how far the end of a path is from its start, along its principal direction and by its
    length: 1 if it never turns back. `moved` [T 2] are its places times `weight` [T]."""
    path = np.concatenate([np.zeros((1, 2)), moved[weight > 0] / weight[weight > 0, None]])
    along = path @ np.linalg.svd(path, full_matrices=False)[2][0]
    return float(np.abs(along[-1]) / np.abs(np.diff(along)).sum())


def _best_seed(
    off: Array, found: NDArray[np.bool_]
) -> tuple[int, Array, NDArray[np.bool_]] | None:
    """Return the feature that explains most, the factors [N] of the others, and which it
    explains."""
    frames = len(off)
    before = truncated_cost((off**2).sum(axis=2), _LIMIT)
    moves = np.sqrt((off**2).sum(axis=2)).max(axis=0, initial=0.0) > _MOVES
    often = found.sum(axis=0) >= _SEED_FRAMES * frames
    seeds = np.nonzero(moves & often)[0]
    best: tuple[int, Array, NDArray[np.bool_]] | None = None
    most = 0.0
    for i in seeds[np.linspace(0, len(seeds) - 1, min(_SEEDS, len(seeds))).astype(int)]:
        shared = found & found[:, i, None]
        here = off[:, i, None] * shared[..., None]
        length = np.maximum(1e-9, (here**2).sum(axis=(0, 2)))
        factor = (here * off).sum(axis=(0, 2)) / length
        predicted = factor[:, None] * here
        room = 1 + _ALONG**2 * (predicted**2).sum(axis=2)
        after = truncated_cost(((off - predicted) ** 2).sum(axis=2) / room, _LIMIT)
        count = shared.sum(axis=0)
        old, new = ((cost * shared).sum(axis=0) for cost in (before, after))
        explained = ((count >= _SHARED_FRAMES * frames) & (old > _UNEXPLAINED * count)
                     & (new < _EXPLAINED * count))
        explained[i] = False
        gain = float(((old - new) * explained).sum())
        if explained.sum() >= _MIN_FEATURES and gain > most:
            most, best = gain, (int(i), factor, explained)
    return best


def _shares(off: Array, found: NDArray[np.bool_], explained: int) -> Array:
    """Return the share [N] of the weight that each feature has: those that go where the homography
    takes them weigh no more together than those whose parallax is seen. A free depth for each of
    hundreds of them would explain their noise by a motion of the camera."""
    cost = (truncated_cost((off**2).sum(axis=2), _LIMIT) * found).sum(axis=0)
    stays = cost <= _UNEXPLAINED * found.sum(axis=0)
    return np.where(stays, min(1.0, explained / max(1, int(stays.sum()))), 1.0)


def _adjust(
    rotation: Array, translation: Array, inverse_depth: Array, views: _Sightings
) -> tuple[Array, Array, Array]:
    """Return rotations [T-1 3 3], translations [T-1 3] and inverse depths [N] after bundle
    adjustment with robust weights."""
    inverse_depth = inverse_depth.clip(-1, 3)
    for scale in _SCALES:
        point = _move(rotation, translation, inverse_depth, views.ray)
        residual = np.where(views.found[..., None], views.seen - _project(point), 0.0)
        square = (residual**2).sum(axis=2) / (scale * views.deviation) ** 2
        weight = views.found * cauchy_weight(square) ** 2 * views.share / views.deviation**2
        camera, depth = _slopes(point, translation, inverse_depth)
        turn, step, by_depth = _solve(camera, depth, residual, weight)
        rotation = Rotation.from_rotvec(turn).as_matrix() @ rotation
        translation = translation + step
        inverse_depth = (inverse_depth + by_depth).clip(-_MAX_INVERSE_DEPTH, _MAX_INVERSE_DEPTH)
        unit = max(1e-9, float(np.sqrt((translation**2).sum(axis=1).mean()))) / _STEP
        translation, inverse_depth = translation / unit, inverse_depth * unit
    return rotation, translation, inverse_depth


def _is_behind(inverse_depth: Array) -> bool:
    """Return whether the nearest of features with inverse depths [N] would be behind the camera:
    the images do not tell whether all these and the translation have the other sign."""
    size = np.abs(inverse_depth)
    return bool(len(size) and np.median(inverse_depth[size >= np.quantile(size, 0.9)]) < 0)


def _move(rotation: Array, translation: Array, inverse_depth: Array, ray: Array) -> Array:
    """Return points [T N 3] of rays [N 3] in each frame, times their inverse depth [N]."""
    turned = np.einsum("tij,nj->tni", rotation, ray)
    return np.asarray(turned + inverse_depth[:, None] * translation[:, None])


def _project(point: Array) -> Array:
    """Return points [... 3] at depth 1, [... 2]."""
    return np.asarray(point[..., :2] / point[..., 2:])


def _slopes(point: Array, translation: Array, inverse_depth: Array) -> tuple[Array, Array]:
    """Return the derivatives of projections of points [T N 3]: [T N 2 6] by turns of the camera and
    its translation, [T N 2] by the inverse depth."""
    z = point[..., 2]
    project = np.zeros((*point.shape[:2], 2, 3))
    project[..., 0, 0] = project[..., 1, 1] = 1 / z
    project[..., 2] = -point[..., :2] / z[..., None] ** 2
    turned = point - inverse_depth[:, None] * translation[:, None]
    turn = np.cross(turned[..., None, :], project)
    by_depth = np.einsum("tnij,tj->tni", project, translation)
    return np.concatenate([turn, inverse_depth[:, None, None] * project], axis=-1), by_depth


def _solve(
    camera: Array, depth: Array, residual: Array, weight: Array
) -> tuple[Array, Array, Array]:
    """Return a step of weighted least squares: turns [T 3], translations [T 3] and inverse depths
    [N]."""
    normal = np.einsum("tn,tnki,tnkj->tij", weight, camera, camera, optimize=True)
    cross = np.einsum("tn,tnki,tnk->tin", weight, camera, depth, optimize=True)
    slope = np.einsum("tn,tnki,tnk->ti", weight, camera, residual, optimize=True)
    damping = _DAMPING * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-9
    inverse = np.linalg.inv(normal + damping * np.eye(6))
    by_depth = np.einsum("tn,tnk,tnk->n", weight, depth, depth)
    down = np.einsum("tn,tnk,tnk->n", weight, depth, residual)
    back = inverse @ cross
    frames, six, count = cross.shape
    reduced = np.diag(by_depth) - cross.reshape(frames * six, count).T @ back.reshape(-1, count)
    reduced += np.diag(_DAMPING * by_depth + _DAMPING * by_depth.mean() + 1e-9)
    right = down - np.einsum("tin,ti->n", back, slope)
    step = np.linalg.solve(reduced, right)
    change = np.einsum("tij,tj->ti", inverse, slope - cross @ step)
    return change[:, :3], change[:, 3:], step
