"""Motions of a door by its outline alone.

A door is a flat box that turns about its hinge, which lies near one side of it. So the place of
the hinge and the direction of the door's plane, in one frame, tell where its outline goes at each
turn (the homography of a plane; Hartley and Zisserman, Multiple View Geometry, Sec. 13.1). Both are
searched on a grid, with the turn of each frame; then a box is fitted to the outline. This needs no
texture, and a frame that shows the door edge-on, where patches are lost, does no harm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, se3
from ..chain import Articulation
from ..images import VideoEvidence
from ..numerics import Image, compiled
from .door_box import (
    NEAREST,
    UNKNOWNS,
    SeenOutline,
    door_box,
    fit_box,
    outline_residuals,
    robust_sum,
    see_outline,
)
from .settings import RgbSettings

_OUTSIDE = 0.5  # cost of a place outside of the image, in costs of an outlier


@dataclass(frozen=True)
class DoorMotion:
    """A box that turns about an axis, in the camera's frame, in units of the door's distance."""

    foot: Array
    """[3] point of the axis that is nearest to the camera"""
    normal: Array
    """[3] of both faces in frame 0, from the one to the other"""
    offset: Array
    """[2] of the faces in frame 0, along `normal`"""
    turn: Array
    """[T] rad, since frame 0"""


def search_outlines(
    video: VideoEvidence, axis: Array, hinge: Array | None, settings: RgbSettings
) -> list[DoorMotion]:
    """Return the motions of a door about a known direction [3] that explain its outline best, the
    best first. `hinge` [3] is a point of the axis, if that is known."""
    seen = see_outline(video, axis, settings)
    if seen is None:
        return []
    place = None if hinge is None else float(seen.angle(hinge))
    found = [fit_box(seen, start, settings, hinge=place)
             for start in _search_grid(seen, place, settings)]
    return [_door_motion(seen, unknown) for _, unknown in sorted(found, key=lambda f: f[0])]


def outline_misfit(video: VideoEvidence, state: Articulation, settings: RgbSettings) -> float:
    """Return how badly the box fits that turns as a door does and fits the seen outline best, px^2.

    This is half the robust square of the distance, a mean over frames and points of the outline.
    It grows as `settings.outline_scale` times the distance where that is large.
    """
    axis, moment = np.split(state.twist[0], 2)
    seen = see_outline(video, axis, settings)
    if seen is None:
        return 0.0
    turn = state.angle[:, 0] - state.angle[seen.first, 0]
    hinge = float(seen.angle(np.cross(axis, moment)))
    starts = [np.array([hinge, tilt, settings.door_thickness, 0.0])
              for tilt in _tilts(settings.outline_tilts)]
    costs = [robust_sum(outline_residuals(seen, np.concatenate([start, turn])), settings)
             for start in starts]
    found = [fit_box(seen, starts[k], settings, turn=turn)[0] for k in np.argsort(costs)[:2]]
    return min(found) / (video.frames * len(seen.ray))


def _tilts(count: int) -> Array:
    return (np.arange(count) + 0.5) * np.pi / count


def _search_grid(
    seen: SeenOutline, hinge: float | None, settings: RgbSettings
) -> list[Array]:
    """The unknowns [4+T] of the best thin doors with distinct turns in the last frame."""
    s = settings
    turns = np.arange(-s.max_outline_turn, s.max_outline_turn + 1e-9, s.outline_turn_step)
    turned = se3.so3_exp(turns[:, None] * seen.axis)
    still, most = int(np.abs(turns).argmin()), round(s.max_outline_step / s.outline_turn_step)
    limit = s.outline_limit * float(np.sqrt(seen.area[seen.first]))
    around = seen.angle(seen.ray)  # seen along the axis, a door is a line
    low, high = np.quantile(around, (0.02, 0.98))
    shares = np.linspace(-s.outline_hinge_margin, s.outline_hinge_margin, s.outline_hinges)
    shares = np.concatenate([shares, 1 + shares]) * (high - low)
    found: list[tuple[float, Array]] = []
    for place in low + shares if hinge is None else [hinge]:
        for tilt in _tilts(s.outline_tilts):
            foot, normal = seen.direction(place), seen.direction(tilt)
            inverse_depth = (seen.ray @ normal) / (normal @ foot)
            scale = float(np.median(inverse_depth))
            if not (s.min_inverse_depth * scale < inverse_depth.min()
                    and inverse_depth.max() < s.max_inverse_depth * scale):
                continue
            foot, inverse_depth = foot * scale, inverse_depth / scale
            costs = _outline_costs(
                seen.ray / inverse_depth[:, None] - foot, foot, turned, seen.intrinsics, seen.away,
                seen.area, seen.is_cut_in, seen.borders, (limit, seen.length))
            cost, path = _cheapest_path(costs, seen.first, still, most, s.outline_jerk_cost)
            found.append((cost, np.concatenate(
                [[place, tilt, s.door_thickness, 0.0], turns[path]])))
    out: list[Array] = []
    for _, unknown in sorted(found, key=lambda f: f[0]):
        turn = unknown[-1] - unknown[UNKNOWNS]
        if all(abs(turn - other[-1] + other[UNKNOWNS]) > s.distinct_motion for other in out):
            out.append(unknown)
    return out[: s.outlines_kept]


@compiled
def _outline_costs(
    place: Array, foot: Array, turned: Array, intrinsics: Array, away: Image, area: Array,
    is_cut: NDArray[np.bool_], cut: NDArray[np.bool_], numbers: tuple[float, float],
) -> Array:
    """Costs [T A] in each frame of an outline [N 3] beside the foot of its axis, after each of
    rotations [A 3 3]: its mean distance from the seen outline, and the difference of the areas."""
    limit, length = numbers
    n, frames, height, width = len(place), away.shape[0], away.shape[1], away.shape[2]
    out = np.full((frames, len(turned)), 2.0)
    u, v = np.zeros(n), np.zeros(n)
    for a in range(len(turned)):
        r, near = turned[a], False
        for i in range(n):
            x, y, z = place[i]
            depth = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + foot[2]
            near = near or depth < NEAREST
            depth = max(depth, NEAREST)
            u[i] = intrinsics[0, 2] + intrinsics[0, 0] * (
                r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + foot[0]) / depth
            v[i] = intrinsics[1, 2] + intrinsics[1, 1] * (
                r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + foot[1]) / depth
        if near:
            continue
        twice = u[n - 1] * v[0] - u[0] * v[n - 1]
        for i in range(n - 1):
            twice += u[i] * v[i + 1] - u[i + 1] * v[i]
        for t in range(frames):
            total = 0.0
            for i in range(n):
                x, y = int(np.rint(u[i])), int(np.rint(v[i]))
                if ((x < 0 and cut[0]) or (x >= width and cut[1]) or (y < 0 and cut[2])
                        or (y >= height and cut[3])):
                    total += _OUTSIDE * limit
                    continue
                inside_x, inside_y = min(max(x, 0), width - 1), min(max(y, 0), height - 1)
                total += min(limit, abs(away[t, inside_y, inside_x])
                             + abs(x - inside_x) + abs(y - inside_y))
            more = abs(twice) / 2 - area[t]
            apart = 0.0 if more > 0 and is_cut[t] else abs(more) / length
            out[t, a] = total / (n * limit) + min(1.0, apart / limit)
    return out


@compiled
def _cheapest_path(
    cost: Array, first: int, still: int, most: int, jerk: float
) -> tuple[float, NDArray[np.int64]]:
    """The least sum of costs [T A], and the path [T] through it, by `still` in frame `first`.

    A step is of at most `most`, and changes by at most 1 from frame to frame, which costs `jerk`
    (dynamic programming over the place and the step before it, on both sides of that frame).
    """
    frames, count = cost.shape
    steps = 2 * most + 1
    change = np.zeros((frames, count, steps), np.int64)
    begin = np.zeros(steps)  # costs of the steps through frame `first`, on both sides
    for way in (-1, 1):
        rest = np.zeros((count, steps))  # of the frames behind one, by place and step
        t = 0 if way < 0 else frames - 1
        while t != first:
            new = np.full((count, steps), np.inf)
            for a in range(count):
                for k in range(steps):
                    for d in range(max(0, k - 1), min(steps, k + 2)):
                        to = a + way * (d - most)
                        if 0 <= to < count:
                            through = cost[t, to] + rest[to, d] + jerk * (d - k) ** 2
                            if through < new[a, k]:
                                new[a, k], change[t, a, k] = through, d - k
            rest = new
            t -= way
        begin += rest[still]
    path = np.full(frames, still)
    for way in (-1, 1):
        a, k, t = still, int(begin.argmin()), first
        while 0 <= t + way < frames:
            t += way
            k += change[t, a, k]
            a += way * (k - most)
            path[t] = a
    return cost[first, still] + begin.min(), path


def _door_motion(seen: SeenOutline, unknown: Array) -> DoorMotion:
    foot, normal, *_, thickness = door_box(seen, unknown)
    turn = unknown[UNKNOWNS:]
    normal = se3.so3_exp(turn[0] * seen.axis) @ normal
    apart = unknown[3] * float(np.linalg.norm(foot))
    return DoorMotion(foot, normal, normal @ foot - apart + np.array([0.0, thickness]),
                      turn - turn[0])
