"""The articulated motion from nothing: starts, tracking under the chain constraint, choice.

A part's motion alone is ill-determined (a link is nearly a cylinder); under the chain each joint
has one unknown a frame. Labels and motion are found in turns (EM), from several starts on the
first frames, which then follow the video; what explains all frames best is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array
from .bundle import ACROSS, ALONG, Articulation, Cloud, Hinges, adjust
from .chain import adjoint, twists_of
from .flow import Flow
from .motion import Correspondence, correspond, costs, fit
from .segment import Candidates, candidates, changed, label_costs, order_from_base, smooth
from .surface import Surfaces

_SLIPS = (0.0075, 0.0015)  # how far a hinge may move in a start, of the object's size
_SLACK = 0.08  # how far an axis may pass from its hinge, of the object's size
_COARSE = 500  # candidates that starts are judged on
_KEY = 3  # frames from one key frame to the next
_CUTS = (0.06, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9)


@dataclass(frozen=True)
class Known:
    """What a method knows of the joints."""

    prismatic: NDArray[np.bool_]
    """[J]"""
    direction: Array | None
    """[J 3]"""
    line: Array | None
    """[J 6]"""

    @property
    def freedom(self) -> int:
        """Unknowns of a revolute axis."""
        return 0 if self.line is not None else 2 if self.direction is not None else 4


@dataclass(frozen=True)
class Hypothesis:
    """An articulation, the parts that go with it, and how badly both explain the frames."""

    state: Articulation
    clouds: tuple[Cloud, ...]
    """Of the key frames; the first is frame 0."""
    cost: float


def spaces(known: Known) -> tuple[Array, ...]:
    """[6 d] of each joint: the twists it may add, about any origin but for known lines."""
    eye, out = np.eye(6), []
    for j, prismatic in enumerate(known.prismatic):
        if known.direction is None:
            out.append(eye[:, 3:] if prismatic else eye)
            continue
        l = known.direction[j]
        if prismatic:
            out.append(np.concatenate([np.zeros(3), l])[:, None])
        elif known.line is not None:
            out.append(known.line[j][:, None])
        else:
            across = np.linalg.svd(l[None])[2][1:].T
            out.append(np.concatenate([np.concatenate([l, np.zeros(3)])[:, None],
                                       np.concatenate([np.zeros((3, 2)), across])], axis=1))
    return tuple(out)


def about(origin: Array, twist: Array) -> Array:
    """Twists [... 6] about the camera's centre as twists about `origin`: v + w x origin."""
    shift = np.eye(4)
    shift[:3, 3] = -origin
    return (adjoint(shift) @ twist[..., None])[..., 0]


def axis_from(added: Array, known: Known, joint: int, hinge: Array, least: float) -> tuple[Array, float]:
    """Twist [6] of unit speed and displacement of a joint that adds `added` [6].

    Where it hardly moves (less than `least`), its axis is taken through `hinge` [3].
    """
    w, v = added[:3], added[3:]
    if known.prismatic[joint]:
        l = known.direction[joint] if known.direction is not None else v / max(1e-12, np.linalg.norm(v))
        return np.concatenate([np.zeros(3), l]), float(l @ v)
    if known.direction is not None:
        l = known.direction[joint]
    else:
        l = w / max(1e-12, float(np.linalg.norm(w)))
        if not l.any():
            l = np.array([0.0, 0.0, 1.0])
    angle = float(l @ w)
    if known.line is not None:
        return known.line[joint].copy(), angle
    across = np.cross(l, hinge)  # velocity of the hinge for a unit turn about the origin
    at_hinge = v + angle * across  # what the hinge does: zero if the axis meets it
    at_hinge -= l * (l @ at_hinge)
    speed = angle if abs(angle) > least else np.copysign(least, angle)
    offset = at_hinge / speed
    far = np.linalg.norm(offset)
    if far > 0.5 * hinge[2]:
        offset *= 0.5 * hinge[2] / far
    return np.concatenate([l, offset - across]), angle


def hinges(points: Array, label: NDArray[np.int64], rank: Array, joints: int) -> Array:
    """[J 3] about where part j meets what carries it: its points that are nearest to the base."""
    out = np.tile(points.mean(axis=0), (joints, 1))
    for j in range(joints):
        outward = np.flatnonzero((label > j) & (rank > 0))
        if len(outward):
            first = outward[np.argsort(rank[outward])[: max(3, len(points) // 50)]]
            out[j] = points[first].mean(axis=0)
    return out


def extent(points: Array) -> float:
    """Size of the points [N 3] along the camera axis they stretch most along, but for strays, m."""
    low, high = np.quantile(points, [0.04, 0.96], axis=0)
    return float((high - low).max())


def first_motion(
    data: Correspondence,
    label: NDArray[np.int64],
    grid: Candidates,
    rank: Array,
    known: Known,
    origin: Array,
    to: int,
    slip: float,
) -> Hypothesis:
    """EM over frames 0 and `to` from initial labels [N]; the displacement goes on evenly."""
    joints = len(known.prismatic)
    space = tuple(about(origin, s.T).T for s in spaces(known))
    added = [np.zeros(6)] * joints
    scale = extent(grid.point[label > 0]) if (label > 0).any() else 1.0
    cost = np.inf
    at = hinges(grid.point, label, rank, joints)
    for _ in range(5):
        at = hinges(grid.point, label, rank, joints)
        prior = np.stack([hinge_prior(p - origin, slip * scale) for p in at])
        added = fit(data, label, space, prior)
        volume = smooth(costs(data, added), grid)
        label = volume.argmin(axis=1)
        cost = float(volume.min(axis=1).mean())
    twist, angle = np.zeros((joints, 6)), np.zeros((to + 1, joints))
    for j in range(joints):
        z = about(-origin, added[j])
        twist[j], end = axis_from(z, known, j, at[j], np.radians(0.3))
        angle[:, j] = np.linspace(0, end, to + 1)
    cloud = Cloud(0, grid.point, grid.normal, grid.shade, label)
    return Hypothesis(Articulation(twist, angle, known.prismatic), (cloud,), cost)


def hinge_prior(hinge: Array, slip: float) -> Array:
    """[6 6] weak belief that a joint turns by some degrees and leaves its hinge [3] in place."""
    turn = 0.15
    x, y, z = hinge
    drag = np.array([[0, z, -y, 1, 0, 0], [-z, 0, x, 0, 1, 0], [y, -x, 0, 0, 0, 1]])
    out = drag.T @ drag / slip**2
    out[:3, :3] += np.eye(3) / turn**2
    return out


class Tracker:
    """The video seen by a hypothesis: clouds of key frames whose labels follow the motion."""

    def __init__(
        self, surfaces: Surfaces, rgb: NDArray[np.uint8], known: Known, most: int
    ) -> None:
        self.surfaces, self.rgb, self.known, self.most = surfaces, rgb, known, most
        self.grids: dict[int, Candidates] = {}
        grid = self.grid(0)
        stays = label_costs(surfaces, grid, np.tile(np.eye(4), (surfaces.frames, 1, 1, 1)))
        moving = stays[:, 0] > 0.9 * (surfaces.frames - 1)
        self.moving = moving if moving.any() else ~moving
        still = ~changed(surfaces, 0)[::4, ::4] & (surfaces.depth[0, ::4, ::4] > 0)
        base = surfaces.points(0, np.argwhere(still)[:, ::-1] * 4)
        self.rank = np.zeros(len(grid.point))
        self.rank[self.moving] = order_from_base(grid.point[self.moving], base)

    def thinned(self, most: int) -> Tracker:
        """The same with fewer candidates."""
        return Tracker(self.surfaces, self.rgb, self.known, most)

    def grid(self, frame: int) -> Candidates:
        """Candidates of a key frame."""
        if frame not in self.grids:
            self.grids[frame] = candidates(self.surfaces, self.rgb, frame, self.most)
        return self.grids[frame]

    def label(self, state: Articulation, frame: int) -> tuple[Cloud, float]:
        """E-step for a frame's candidates; and their mean cost a frame."""
        grid = self.grid(frame)
        volume = label_costs(self.surfaces, grid, state.motions(len(state.angle)))
        volume = smooth(volume, grid, 4 if self.surfaces.noise else 2)
        cost = float(volume.min(axis=1).mean()) / max(1, len(state.angle) - 1)
        return Cloud(frame, grid.point, grid.normal, grid.shade, volume.argmin(axis=1)), cost

    def relabel(self, state: Articulation, frames: tuple[int, ...]) -> Hypothesis:
        """E-step for key frames."""
        both = [self.label(state, f) for f in frames]
        return Hypothesis(state, tuple(c for c, _ in both), float(np.mean([c for _, c in both])))

    def follow(self, guess: Hypothesis, until: int) -> Hypothesis:
        """Track on from the last frame of a hypothesis to frame `until`."""
        for last in range(len(guess.state.angle), until + 1):
            angle = guess.state.angle
            step = angle[-1] - angle[-2] if last > 1 else np.zeros_like(angle[-1])
            state = replace(guess.state, angle=np.concatenate([angle, angle[-1:] + step]))
            state = self.fit(guess.clouds, state, (8.0, 4.0), newest=True)
            state = self.fit(guess.clouds, state, (3.0, 1.5))
            keys = tuple(c.frame for c in guess.clouds)
            guess = self.relabel(state, (*keys, last) if last % _KEY == 0 else keys)
        return guess

    def settle(
        self, guess: Hypothesis, rounds: int, scales: tuple[float, ...] = (4.0, 2.0, 1.0)
    ) -> Hypothesis:
        """EM over the frames that a hypothesis has."""
        for _ in range(rounds):
            state = self.fit(guess.clouds, guess.state, scales)
            guess = self.relabel(state, tuple(c.frame for c in guess.clouds))
        return guess

    def hinges(self, cloud: Cloud) -> Hinges:
        """Where frame 0's labels put the joints."""
        at = hinges(cloud.point, cloud.label, self.rank, len(self.known.prismatic))
        return Hinges(at, _SLACK * extent(cloud.point[self.moving]))

    def fit(
        self,
        clouds: tuple[Cloud, ...],
        state: Articulation,
        scales: tuple[float, ...],
        newest: bool = False,
    ) -> Articulation:
        """M-step."""
        return adjust(
            self.surfaces, clouds, state, self.known.freedom, scales, self.hinges(clouds[0]), newest
        )[0]


def starts(rank: Array, moving: NDArray[np.bool_], joints: int) -> list[NDArray[np.int64]]:
    """Initial labels: moving points cut into J runs from the base outward, in many ways."""
    out: list[NDArray[np.int64]] = []
    for cuts in combinations(_CUTS, joints - 1):
        out.append(np.where(moving, 1 + np.searchsorted(np.array(cuts), rank), 0))
    return out


def search(tracker: Tracker, flow: Flow) -> Hypothesis:
    """The best hypothesis over all frames, from many starts on the first ones.

    Many are judged on few points and frames, few on all. Where axes are unknown, or depth is
    noisy, the first frames decide less: more are kept for longer.
    """
    end, known = tracker.surfaces.frames - 1, tracker.known
    hard = known.freedom == 4 or (known.freedom > 0 and tracker.surfaces.noise > 0)
    coarse = tracker.thinned(_COARSE) if hard else tracker
    wide, middling = (16.0, 8.0, 4.0, 2.0), (4.0, 4.0, 2.0, 2.0)
    found = beginnings(coarse, flow, (2, 4) if hard else (1, 2), 9 if hard else 8)
    found = [coarse.settle(extend(h, min(2, end)), 2, wide) for h in found]
    if hard:
        found = [coarse.follow(h, min(4, end)) for h in distinct(found, 24)]
        found = [coarse.settle(h, 1, middling) for h in distinct(found, 16)]
        found = [coarse.follow(h, min(7, end)) for h in distinct(found, 10)]
        found = [coarse.settle(h, 2, middling) for h in distinct(found, 6)]
        found = [tracker.relabel(h.state, tuple(c.frame for c in h.clouds))
                 for h in distinct(found, 4)]
    else:
        found = [tracker.follow(h, min(5, end)) for h in distinct(found, 6)]
    found = [tracker.follow(h, end) for h in distinct(found, 3)]
    best = tracker.settle(distinct(found, 1)[0], 2)
    return squared(tracker, best) if known.freedom == 4 else best


def beginnings(tracker: Tracker, flow: Flow, spans: tuple[int, ...], most: int) -> list[Hypothesis]:
    """The best starts by flow from frame 0 over each of `spans` frames."""
    grid, known, rank = tracker.grid(0), tracker.known, tracker.rank
    origin = grid.point[tracker.moving].mean(axis=0)
    first = starts(rank, tracker.moving, len(known.prismatic))
    found: list[Hypothesis] = []
    for span in spans:
        to = min(span, tracker.surfaces.frames - 1)
        field = flow(tracker.rgb[0], tracker.rgb[to])
        field = field[grid.pixel[:, 1], grid.pixel[:, 0]].astype(np.float64)
        data = correspond(tracker.surfaces, grid.point, grid.pixel, field, to, origin)
        for slip in _SLIPS if known.freedom else _SLIPS[:1]:
            some = [first_motion(data, label, grid, rank, known, origin, to, slip)
                    for label in first]
            found += distinct(some, most)
    return found


def squared(tracker: Tracker, best: Hypothesis) -> Hypothesis:
    """Where directions are unknown: neighbouring axes at right angles or parallel, if they fit."""
    joints = len(best.state.prismatic)
    ways = [replace(best, state=replace(best.state, relation=way))
            for way in product((ACROSS, ALONG), repeat=joints - 1)]
    found = [best, *(tracker.settle(h, 3) for h in ways)]
    return min(found, key=lambda h: h.cost * (1.0 if h.state.relation else 1.05))


def extend(guess: Hypothesis, until: int) -> Hypothesis:
    """Go on evenly to frame `until`."""
    angle = guess.state.angle[: until + 1]
    while len(angle) <= until:
        angle = np.concatenate([angle, 2 * angle[-1:] - angle[-2:-1]])
    return replace(guess, state=replace(guess.state, angle=angle))


def distinct(found: list[Hypothesis], most: int) -> list[Hypothesis]:
    """The best few whose labels differ."""
    out: list[Hypothesis] = []
    for h in sorted(found, key=lambda h: h.cost):
        if all(
            np.mean(h.clouds[0].label != other.clouds[0].label) > 0.02
            or h.state.relation != other.state.relation
            for other in out
        ):
            out.append(h)
        if len(out) == most:
            break
    return out


def knowledge(prismatic: NDArray[np.bool_], direction: Array | None, line: Array | None) -> Known:
    """Known axes as twists."""
    if line is not None:
        return Known(prismatic, line[:, :3], twists_of(line, prismatic))
    return Known(prismatic, direction, None)
