"""Starts without flow: every joint's first step in a grid of values, judged by depth alone.

An arm that reaches for the camera moves by a hundred pixels a frame, where no flow follows it; but
its joints turn by a few degrees a frame, whatever the image does. So a coarse grid of steps, times
the places where the parts may begin, holds a start near the truth: a hinge that is wrong by some
centimetres hardly matters for so small a turn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.distance import cdist

from ..robots.geometry import Array
from .articulation import Articulation, Cloud, Hypothesis
from .chain import joint_motion
from .crew import together
from .knowledge import Known
from .segment import smooth
from .surface import Image, Surfaces
from .tracker import Tracker, thinned

_TURN, _SLIDE = np.radians(6.5), 0.06  # largest step of a frame that is looked for, rad and m
_REACH = 2.0  # how much further it looks over longer spans
_VALUES = 5  # of a step
_PLACES = 10  # where a hinge may be
_BEAM = 2500  # chains that are carried on to the next joint
_POINTS = 120
_BLOCK = 40000  # points that are judged at a time
_COARSE = 6.0  # px, of what a grid leaves


def swept(tracker: Tracker, to: int, most: int) -> list[Hypothesis]:
    """The `most` best starts over frames 0 and `to`; none where axes' directions are unknown.

    A beam search along the chain: a joint's hinge is at one of some places on what moves, its step
    one of some values; a point costs what the best part so far costs it.
    """
    grid, known, surfaces = tracker.grid(0), tracker.known, tracker.surfaces
    if known.direction is None:
        return []
    inside = grid.point[tracker.moving]
    pick = np.linspace(0, len(inside) - 1, min(len(inside), _POINTS)).astype(int)
    points, normals = inside[pick], grid.normal[tracker.moving][pick]
    places = spread(thinned(inside, 400), _PLACES)
    reach = min(to, _REACH)
    motion = np.eye(4)[None]
    cost = judged(surfaces, to, motion, points, normals)
    place, angle = np.zeros((1, 0), np.int64), np.zeros((1, 0))
    for j, prismatic in enumerate(known.prismatic):
        lines = np.stack([line(known, j, p) for p in places])
        if known.line is not None or prismatic:
            lines = lines[:1]
        values = _VALUES if len(lines) > 1 else 2 * _VALUES - 1
        step = np.linspace(-1, 1, values) * reach * (_SLIDE if prismatic else _TURN)
        turn = np.stack([joint_motion(l, step) for l in lines])  # [P V 4 4]
        motion = (motion[:, None, None] @ turn).reshape(-1, 4, 4)
        each = len(lines) * values
        cost = cost.repeat(each, axis=0)
        cost = np.minimum(cost, judged(surfaces, to, motion, points, normals))
        which = np.tile(np.arange(len(lines)).repeat(values), len(place))
        place = np.concatenate([place.repeat(each, axis=0), which[:, None]], axis=1)
        turned = np.tile(step, len(lines) * len(angle))
        angle = np.concatenate([angle.repeat(each, axis=0), turned[:, None]], axis=1)
        best = np.argsort(cost.mean(axis=1), kind="stable")[:_BEAM]
        motion, cost, place, angle = motion[best], cost[best], place[best], angle[best]
    found: list[Hypothesis] = []
    for at, end, c in zip(place[:most], angle[:most], cost[:most].mean(axis=1), strict=True):
        twist = np.stack([line(known, j, places[p]) for j, p in enumerate(at)])
        order = int(np.argmin([np.linalg.norm(b - places[at[0]]) for b in tracker.bases]))
        state = Articulation(twist, np.linspace(0 * end, end, to + 1), known.prismatic)
        found.append(Hypothesis(state, (), float(c), order))
    return [replace(h, clouds=(coarse_cloud(tracker, h.state),)) for h in found]


def spread(points: Array, most: int) -> Array:
    """Places [P 3] all over the points [N 3], each the middle of those that are near."""
    apart = cdist(points, points)
    chosen = [0]
    while len(chosen) < min(most, len(points)):
        chosen.append(int(apart[chosen].min(axis=0).argmax()))
    near = apart[chosen].argmin(axis=0)
    return np.stack([points[near == c].mean(axis=0) for c in range(len(chosen))])


def coarse_cloud(tracker: Tracker, state: Articulation) -> Cloud:
    """Frame 0's points labelled by what brings them near the last frame's surface."""
    grid, last = tracker.grid(0), len(state.angle) - 1
    motion = state.motions(last + 1)[last]
    cost = judged(tracker.surfaces, last, motion, grid.point, grid.normal).T
    label = smooth(cost.astype(np.float64), grid).argmin(axis=1)
    return Cloud(0, grid.point, grid.normal, grid.shade, label)


def line(known: Known, joint: int, at: Array) -> Array:
    """Twist [6] of a joint through a point [3]."""
    assert known.direction is not None
    if known.line is not None:
        return known.line[joint]
    l = known.direction[joint]
    if known.prismatic[joint]:
        return np.concatenate([np.zeros(3), l])
    return np.concatenate([l, np.asarray(np.cross(at, l), np.float64)])


def judged(
    surfaces: Surfaces, frame: int, motion: Array, points: Array, normals: Array
) -> Image:
    """[M N] coarse cost of points [N 3] moved by each of motion [M 4 4] into a frame."""
    block = max(1, _BLOCK // max(1, len(points)))  # what stays in the processor's cache
    blocks = [motion[m : m + block] for m in range(0, len(motion), block)]
    costs = together(lambda b: judged_block(surfaces, frame, b, points, normals), blocks)
    return np.concatenate(costs)


def judged_block(
    surfaces: Surfaces, frame: int, motion: Array, points: Array, normals: Array
) -> Image:
    """The same of few."""
    k = surfaces.intrinsics.astype(np.float32)
    height, width = surfaces.depth.shape[1:]
    turn, shift = motion[:, :3, :3].astype(np.float32), motion[:, :3, 3].astype(np.float32)
    x, y, z = np.moveaxis(turn @ points.T.astype(np.float32) + shift[..., None], 1, 0)
    nx, ny, nz = np.moveaxis(turn @ normals.T.astype(np.float32), 1, 0)
    z = np.maximum(z, np.float32(1e-3))
    x, y = x / z, y / z
    u = np.rint(k[0, 0] * x + k[0, 2])
    v = np.rint(k[1, 1] * y + k[1, 2])
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    pixel = np.where(inside, v * width + u, 0).astype(np.int32)
    depth = surfaces.depth[frame].reshape(-1).take(pixel)
    gap = np.where(depth > 0, depth - z, np.float32(10.0))
    scale = z * (np.float32(_COARSE) / k[0, 0]) + np.float32(2 * surfaces.noise)
    cost = np.square(gap * (nx * x + ny * y + nz) / scale)
    cost = np.minimum(cost, np.where(gap > 0, np.float32(9.0), np.float32(3.0)))
    return np.where(inside, cost, np.float32(2.0))
