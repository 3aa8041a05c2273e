"""A door: one turning joint, whose points lie near planes that are parallel to its axis.

The slope and the turn of a door are ambiguous: a search ends in the nearest of several minima. So
other turns are tried, each with the plane that shows the same motion in the images; and depths are
searched among planes, because bundle adjustment follows patches only over a few pixels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, se3
from ..chain import Articulation
from ..images import VideoEvidence
from .evidence import VideoHypothesis
from .measurements import patch_costs_by_point
from .points import InverseDepthPoints, inverse_depth_slopes, predict_places
from .settings import RgbSettings

_FIT_ITERATIONS = 8
_PACE_FRAMES = 3  # whose mean pace a door continues


def is_door(state: Articulation) -> bool:
    """Return whether the object is one part that turns."""
    return len(state.twist) == 1 and not state.prismatic[0]


def inverse_depths_on_plane(
    state: Articulation, points: InverseDepthPoints, normal: Array, offset: float
) -> tuple[Array, Array]:
    """Return the inverse depths [N], and their slopes [N 2] by the ray, of points on a plane of the
    part: normal @ X = offset in frame 0."""
    motion = state.motions(len(state.angle))[points.frame, 1]
    turned = motion[:, :3, :3] @ normal
    away = offset + np.einsum("na,na->n", turned, motion[:, :3, 3])
    gradient = turned / np.where(np.abs(away) < 1e-6, 1e-6, away)[:, None]
    return np.einsum("na,na->n", gradient, points.ray), gradient[:, :2]


def vary_door_plane(hypothesis: VideoHypothesis, settings: RgbSettings) -> list[VideoHypothesis]:
    """Return the motion of a door with its points in each of several planes through its axis."""
    state = hypothesis.state
    foot = np.cross(state.twist[0, :3], state.twist[0, 3:])
    if not is_door(state) or not foot.any():
        return []
    found = [_put_on_plane(hypothesis, state, normal, float(normal @ foot), settings)
             for normal in _plane_normals(state, settings.tilts)]
    return [h for h in found if h is not None]


def exchange_door_turn(
    hypothesis: VideoHypothesis, intrinsics: Array, settings: RgbSettings
) -> list[VideoHypothesis]:
    """Return other turns of a door, each with an axis and a plane with which its points of frame 0
    go nearly to the same places in the images.

    The turns between frame 0 and the last frame form a grid. The homography of a plane is
    R + t n^T. Its turn gives R, and the translation t and the normal n lie across the axis, so that
    only a matrix of rank one is unknown (Hartley and Zisserman, Multiple View Geometry, Sec. 13.1).
    """
    s, axis = settings, hypothesis.state.twist[0, :3]
    ray, place = _places_from_start(hypothesis, intrinsics)
    if not is_door(hypothesis.state) or len(ray) < s.min_points:
        return []
    limit = s.exchange_limit / float(intrinsics[0, 0])
    out: list[VideoHypothesis] = []
    for turn in np.arange(-s.max_door_turn, s.max_door_turn + 1e-9, s.door_turn_step):
        if abs(turn) < s.door_turn_step / 2:
            continue
        foot, normal = fit_plane_motion(ray, place[-1], axis, turn, limit)
        if not s.door_axis_reach[0] < normal @ foot < s.door_axis_reach[1]:
            continue
        angle = fit_turns(ray, ray @ normal, place, (axis, foot), turn, limit)
        other = _turn_plane(hypothesis, angle, foot, normal, s)
        if other is not None:
            out.append(other)
    return out


def turn_by_edges(
    hypothesis: VideoHypothesis, turn: Array, intrinsics: Array, settings: RgbSettings
) -> VideoHypothesis | None:
    """Return a door with given turns [T], with an axis and a plane with which its points of frame 0
    go nearly to the same places in the frame with the largest turn; None if there is none."""
    s, far = settings, int(np.abs(turn).argmax())
    ray, place = _places_from_start(hypothesis, intrinsics)
    if len(ray) < s.min_points or abs(turn[far]) < s.min_edge_turn:
        return None
    foot, normal = fit_plane_motion(
        ray, place[far], hypothesis.state.twist[0, :3], float(turn[far]),
        s.exchange_limit / float(intrinsics[0, 0]))
    return _turn_plane(hypothesis, turn, foot, normal, s)


def _places_from_start(hypothesis: VideoHypothesis, intrinsics: Array) -> tuple[Array, Array]:
    """The rays [N 3] of the points of frame 0, and their places [T N 2] at depth 1."""
    mine = hypothesis.points.frame == 0
    place = predict_places(hypothesis.state, hypothesis.points, intrinsics)[mine].swapaxes(0, 1)
    place = (place - intrinsics[:2, 2]) / intrinsics[[0, 1], [0, 1]]
    return hypothesis.points.ray[mine], place


def _turn_plane(
    hypothesis: VideoHypothesis, turn: Array, foot: Array, normal: Array, settings: RgbSettings
) -> VideoHypothesis | None:
    """The hypothesis with turns [T] about an axis with another foot [3], its points on the plane
    normal @ X = 1; None where few of the points can lie on it."""
    axis = hypothesis.state.twist[0, :3]
    line = np.concatenate([axis, np.cross(foot, axis)])[None]
    state = replace(hypothesis.state, twist=line, angle=turn[:, None])
    return _put_on_plane(hypothesis, state, normal, 1.0, settings)


def fit_plane_motion(
    ray: Array, place: Array, axis: Array, turn: float, limit: float
) -> tuple[Array, Array]:
    """Return the foot [3] of the axis, and the normal [3] of a plane normal @ X = 1, with which
    rays [N 3] go to places [N 2] at depth 1 when the plane turns; their mean inverse depth is 1.

    Errors above `limit` count less.
    """
    across = np.linalg.svd(axis[None])[2][1:]  # [2 3]
    rotation = se3.so3_exp(turn * axis)
    moved, by_plane = ray @ rotation.T, ray @ across.T
    basis = np.einsum("ac,nb->ncab", across, by_plane).reshape(len(ray), 3, 4)
    unknown, weight = np.zeros(4), np.ones(len(ray))
    for _ in range(_FIT_ITERATIONS):
        depth = np.maximum(moved[:, 2] + basis[:, 2] @ unknown, 0.1)
        share = (np.sqrt(weight) / depth)[:, None]
        row = share[..., None] * (basis[:, :2] - place[..., None] * basis[:, 2:])
        right = share * (place * moved[:, 2:] - moved[:, :2])
        unknown = np.linalg.lstsq(row.reshape(-1, 4), right.ravel(), rcond=None)[0]
        at = moved + basis @ unknown
        away = at[:, :2] / np.maximum(at[:, 2:], 0.1) - place
        weight = 1 / (1 + (away**2).sum(axis=1) / limit**2) ** 2
    left, size, right_vectors = np.linalg.svd(unknown.reshape(2, 2))
    scale = float(np.mean(by_plane @ right_vectors[0]))
    scale = scale if abs(scale) > 1e-6 else 1e-6
    shift, normal = scale * size[0] * left[:, 0], right_vectors[0] / scale
    foot = np.linalg.solve(np.eye(2) - across @ rotation @ across.T, shift)
    return foot @ across, normal @ across


def fit_turns(
    ray: Array, inverse_depth: Array, place: Array, line: tuple[Array, Array], last: float,
    limit: float,
) -> Array:
    """Return the turns [T] about a line (its direction and foot) with which points of frame 0 go to
    places [T N 2] at depth 1; the first is 0, and the last starts from `last`."""
    axis, foot = line
    inner = ray - inverse_depth[:, None] * foot
    out = np.linspace(0.0, last, len(place))
    for _ in range(_FIT_ITERATIONS):
        turned = np.einsum("tab,nb->tna", np.stack([se3.so3_exp(a * axis) for a in out]), inner)
        at, by_turn = turned + inverse_depth[:, None] * foot, np.cross(axis, turned)
        depth = np.maximum(at[..., 2:], 0.1)
        away = at[..., :2] / depth - place
        slope = (by_turn[..., :2] - at[..., :2] / depth * by_turn[..., 2:]) / depth
        weight = 1 / (1 + (away**2).sum(axis=2, keepdims=True) / limit**2) ** 2
        step = (weight * slope * away).sum(axis=(1, 2))
        step /= np.maximum((weight * slope**2).sum(axis=(1, 2)), 1e-12)
        out = out - np.clip(step, -0.1, 0.1)
    return out - out[0]


def edge_on_frames(evidence: VideoEvidence, settings: RgbSettings) -> list[int]:
    """Return the frame in which a door is seen edge-on, and those beside it, but not the first and
    the last; an empty list where the foreground is nowhere small."""
    area = evidence.moving.sum(axis=(1, 2))
    least = int(area.argmin())
    if area[least] > settings.edge_on_share * np.median(area):
        return []
    return [t for t in (least, least - 1, least + 1) if 0 < t < len(area) - 1]


def bridge_edge_on(
    hypothesis: VideoHypothesis, frames: list[int], settings: RgbSettings
) -> list[VideoHypothesis]:
    """Return a door with other turns between the frames before and after it is seen edge-on, or
    with other turns in all frames of one side, and with one plane for all frames.

    Hardly a patch is found on both sides of such a frame. So what comes before and what comes
    after may each be right, and the turn between them wrong. Or the turns and the depths of one of
    them are wrong: a plane that turns less and slopes more looks nearly the same.
    """
    sizes = [sign * size for size in settings.edge_on_shifts for sign in (-1, 1)]
    found = [_shift_turns(hypothesis, frame, size) for frame in frames for size in sizes]
    edge, at = frames[0], hypothesis.points.frame
    for before, right in ((False, at < edge), (True, at > edge)):
        if np.count_nonzero(right) < settings.min_points:
            continue
        turned = [_shift_turns(hypothesis, edge, size) for size in (0.0, *sizes)]
        turned += [_continue_turn(hypothesis, edge, before, pace)
                   for pace in settings.edge_on_paces]
        found += [_extend_plane(other, right, settings) for other in turned]
    return found


def _shift_turns(hypothesis: VideoHypothesis, frame: int, shift: float) -> VideoHypothesis:
    """A door that turns by more from the frame before to the frame after."""
    state = hypothesis.state
    share = np.clip((np.arange(len(state.angle)) - frame + 1) / 2, 0, 1)[:, None]
    return replace(hypothesis, state=replace(
        state, angle=state.angle + shift * (share - share[0])))


def _continue_turn(
    hypothesis: VideoHypothesis, edge: int, before: bool, pace: float
) -> VideoHypothesis:
    """A door that turns before or after a frame as on the other side of it, times `pace`."""
    state = hypothesis.state
    angle = state.angle[::-1] if before else state.angle
    last = max(1, (len(angle) - 1 - edge if before else edge) - 1)  # of the frames that stay
    first = max(0, last - _PACE_FRAMES)
    step = pace * (angle[last] - angle[first]) / (last - first)
    angle = np.concatenate(
        [angle[: last + 1], angle[last] + step * np.arange(1, len(angle) - last)[:, None]])
    angle = angle[::-1] if before else angle
    return replace(hypothesis, state=replace(state, angle=angle - angle[0]))


def _extend_plane(
    hypothesis: VideoHypothesis, fitted: NDArray[np.bool_], settings: RgbSettings
) -> VideoHypothesis:
    """A door with its other points on the plane, parallel to its axis, that fits some of them."""
    state, points = hypothesis.state, hypothesis.points
    across = np.linalg.svd(state.twist[:1, :3])[2][1:]
    motion = state.motions(len(state.angle))[points.frame[fitted], 1]
    here = points.ray[fitted] / points.inverse_depth[fitted, None] - motion[:, :3, 3]
    at = np.einsum("nba,nb,ca->nc", motion[:, :3, :3], here, across)  # in frame 0
    middle, normal, weight = np.zeros(2), np.zeros(2), np.ones(len(at))
    for _ in range(_FIT_ITERATIONS):
        middle = np.average(at, axis=0, weights=weight)
        normal = np.linalg.svd(np.sqrt(weight)[:, None] * (at - middle), full_matrices=False)[2][1]
        away = np.abs((at - middle) @ normal)
        weight = 1 / (1 + (away / max(1e-3, float(np.median(away)))) ** 2) ** 2
    depth, _ = inverse_depths_on_plane(state, points, normal @ across, float(normal @ middle))
    kept = fitted | ~_is_possible(depth, settings)
    return replace(hypothesis, points=replace(
        points, inverse_depth=np.where(kept, points.inverse_depth, depth)))


def search_depths(
    evidence: VideoEvidence, hypothesis: VideoHypothesis, settings: RgbSettings
) -> VideoHypothesis:
    """Return a door with each point on that plane, of several that are parallel to its axis, on
    which the patches around it are found best; or at its own depth, if that is better."""
    s, state, points = settings, hypothesis.state, hypothesis.points
    first = points.frame == points.frame.min()
    if not is_door(state) or points.neighbors is None:
        return hypothesis
    center = (points.ray[first] / points.inverse_depth[first, None]).mean(axis=0)
    tried = [(points.inverse_depth, inverse_depth_slopes(points, s))]
    for normal in _plane_normals(state, s.plane_tilts):
        tried += [inverse_depths_on_plane(state, points, normal, float(normal @ center) * depth)
                  for depth in s.plane_depths]
    cost = np.empty((len(points.ray), len(tried)))
    for k, (inverse_depth, slope) in enumerate(tried):
        valid = _is_possible(inverse_depth, s)
        at = replace(points, inverse_depth=np.where(valid, inverse_depth, 1.0))
        cost[:, k] = np.where(
            valid, patch_costs_by_point(evidence, state, at, slope, s), s.patch_outlier_cost)
    share = points.neighbors / np.maximum(1.0, points.neighbors.sum(axis=1))[:, None]
    best = (share @ (share @ cost)).argmin(axis=1)
    depths = np.stack([q for q, _ in tried], axis=1)[np.arange(len(best)), best]
    depths = np.clip(depths, s.min_inverse_depth, s.max_inverse_depth)
    return replace(hypothesis, points=replace(points, inverse_depth=depths))


def _plane_normals(state: Articulation, count: int) -> Array:
    """Normals [count 3] of planes that are parallel to the axis."""
    one, other = np.linalg.svd(state.twist[:1, :3])[2][1:]
    turn = (np.arange(count)[:, None] + 0.5) * np.pi / count
    return np.asarray(np.cos(turn) * one + np.sin(turn) * other, np.float64)


def _is_possible(inverse_depth: Array, settings: RgbSettings) -> NDArray[np.bool_]:
    return ((inverse_depth > settings.min_inverse_depth)
            & (inverse_depth < settings.max_inverse_depth))


def _put_on_plane(
    hypothesis: VideoHypothesis, state: Articulation, normal: Array, offset: float,
    settings: RgbSettings,
) -> VideoHypothesis | None:
    """The hypothesis with a motion, its points on a plane, and their mean inverse depth 1; None
    where few of the points can lie on the plane."""
    s, points = settings, hypothesis.points
    inverse_depth, _ = inverse_depths_on_plane(state, points, normal, offset)
    scale = float(np.median(inverse_depth))
    if not s.min_tilt_scale < scale < s.max_tilt_scale:
        return None
    inverse_depth = inverse_depth / scale
    if np.mean(_is_possible(inverse_depth, s)) < s.min_tilt_share:
        return None
    line = state.twist * np.repeat([1.0, scale], 3)
    inverse_depth = np.clip(inverse_depth, s.min_inverse_depth, s.max_inverse_depth)
    return replace(hypothesis, state=replace(state, twist=line),
                   points=replace(points, inverse_depth=inverse_depth))
