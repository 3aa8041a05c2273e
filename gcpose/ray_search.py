"""EM over a video without depth (Sec. 3.2 to 3.4): from many first guesses to one articulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, cycle, product

import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array, inverse
from .articulation import Articulation
from .crew import together
from .footage import CONTRAST, Footage
from .knowledge import Known
from .patches import match
from .prior import Hinges
from .ray_bundle import Rays, adjust_rays, places
from .ray_labels import FLOW_RATE, FLOW_SIGMA, Spots, along_chain, label_costs, spots
from .segment import order_from_base
from .sweep import spread
from .tracker import hinges, thinned
from .trade import feet, shared

_CUTS = (0.0, 0.1, 0.25, 0.4, 0.55, 0.7, 0.85)  # of the way from the base outward
_SHARE = 0.2  # of its pixels, of those whose flow errs independently
_FEW, _MANY = 220, 130  # points of a key frame, in the search and at its end
_FEWEST = 20  # that are worth a search
_FIRST, _SECOND, _TRADED = 6, 4, 3  # hypotheses that go on
_APART = 0.2  # of two hypotheses, rad or m
_FLAT = 0.1  # standard deviation of inverse depths at first
_BELIEF = 4.0  # weight of what is believed beforehand, in the search
_SLACK = 0.1  # how far an axis may pass from its hinge, of the distance to the camera
_PARALLEL, _PLACES = 0.98, 16  # cosine; where a hinge may be
_SHARES = (-1.5, -0.75, 0.0, 0.5, 1.0, 1.75, 2.5)
_RADIUS = 6  # px, of a patch
_REACH = 3.0  # px, from where a patch is expected
_SPAN = 3  # frames from a patch's own within which it is looked for
_MODEL, _MODEL_RATE = 0.2, 0.05  # px, what a patch errs by, and more with each frame
_LOST = 9.0  # cost of a patch that is not found, of a standard deviation's
_TRUST = 3.0  # of their information: beside it, what is believed beforehand is little
_EVEN = 2.0  # grey levels a pixel: weaker gradients are shading


@dataclass(frozen=True)
class Guess:
    """A hypothesis: an articulation and the parts and depths of its points."""

    state: Articulation
    rays: Rays
    base: Array
    """[3] where the chain begins, at depth 1"""
    cost: float
    hessian: Array


class Searcher:
    """The footage seen by hypotheses."""

    def __init__(self, seen: Footage, known: Known) -> None:
        self.seen, self.known = seen, known
        self.joints = len(known.prismatic)
        self.spots: dict[tuple[int, ...], Spots] = {}
        self.known_ranks: dict[tuple[int, float, float], Array] = {}

    def points(self, frames: tuple[int, ...], most: int) -> Spots:
        if frames not in self.spots:
            self.spots[frames] = spots(self.seen, frames, most)
        return self.spots[frames]

    def observed(self, guess: Guess, at: Array | None = None) -> Rays:
        """The flow at the points' places."""
        seen, rays = self.seen, guess.rays
        last = len(guess.state.angle) - 1
        if at is None:
            at = places(guess.state, rays, seen.intrinsics)[0]
        height, width = seen.moving.shape[1:]
        pixel = np.rint(np.clip(at, -2, 1e4)).astype(np.int64)[:, :last]
        u, v = pixel[..., 0], pixel[..., 1]
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        u, v = np.where(inside, u, 0), np.where(inside, v, 0)
        t = np.arange(last)[None]
        step = seen.flow[t, v, u].astype(np.float64)
        hold = seen.hold[t, v, u].astype(np.float64)
        good = inside & seen.moving[t, v, u]
        weight = _SHARE * good / (FLOW_SIGMA**2 + FLOW_RATE**2 * (step**2).sum(axis=2))
        information = hold[..., [0, 1, 1, 2]].reshape(*hold.shape[:2], 2, 2)
        return replace(
            rays,
            step=step,
            step_information=information * weight[..., None, None],
            spot=np.zeros((len(u), last + 1, 2)),
            spot_information=np.zeros((len(u), last + 1, 2, 2)),
        )

    def matched(self, guess: Guess, reach: float, span: int) -> Rays:
        """Where patches around the points are found in the frames near their own."""
        seen, rays = self.seen, guess.rays
        at, warp = places(guess.state, rays, seen.intrinsics)
        frames = len(guess.state.angle)
        height, width = seen.moving.shape[1:]
        pixel = np.rint(np.clip(at, -2, 1e4)).astype(np.int64)
        u, v = pixel[..., 0], pixel[..., 1]
        gap = np.abs(np.arange(frames)[None] - rays.frame[:, None])
        wanted = (gap > 0) & (gap <= span)
        wanted &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
        u, v = np.where(wanted, u, 0), np.where(wanted, v, 0)
        wanted &= seen.moving[np.arange(frames)[None], v, u]
        own = at[np.arange(len(at)), rays.frame]
        found, information = match(
            seen.look, own, rays.frame, at, warp, wanted, _RADIUS, reach, _MODEL, _MODEL_RATE,
            CONTRAST, _EVEN,
        )  # fmt: skip
        none = np.zeros((len(at), frames - 1, 2))
        return replace(
            rays, step=none, step_information=np.zeros((*none.shape, 2)),
            spot=found, spot_information=_TRUST * information,
        )  # fmt: skip

    def relabel(self, guess: Guess, points: Spots) -> Guess:
        """E-step: the parts of `points`, which need not be the guess's own."""
        seen, state = self.seen, guess.state
        motion = state.motions(len(state.angle))
        keys = np.unique(points.frame)
        relative = np.stack([motion @ inverse(motion[k]) for k in keys])
        k = seen.intrinsics
        own = len(points.frame) == len(guess.rays.frame)
        depth = guess.rays.inverse_depth if own else points.expected
        depth = np.repeat(depth[:, None], self.joints, axis=1)
        for steps in (4, 0):  # neighbours have about one depth
            cost, depth = label_costs(
                points.ray, np.searchsorted(keys, points.frame), depth, relative,
                float(k[0, 0]), float(k[0, 2]), float(k[1, 2]),
                seen.flow, seen.hold, seen.moving, steps,
            )  # fmt: skip
            if steps:
                depth = points.average(depth)
        total = points.average(cost)
        rank = self.ranks(points, guess.base)
        label = along_chain(total, rank, points.frame)
        if points.part is not None:
            label = points.part - 1
        mine = np.arange(len(label)), label
        rays = replace(
            guess.rays, frame=points.frame, ray=points.ray, label=label + 1,
            inverse_depth=depth[mine], expected=points.expected,
        )  # fmt: skip
        return replace(guess, rays=rays, cost=float(total[mine].mean()))

    def ranks(self, points: Spots, base: Array) -> Array:
        """[N] how far out each point is in its key frame."""
        name = (len(points.frame), float(base[0]), float(base[1]))
        if name not in self.known_ranks:
            out = np.zeros(len(points.frame))
            for f in np.unique(points.frame):
                mine = points.frame == f
                out[mine] = order_from_base(points.ray[mine], base[None])
            self.known_ranks[name] = out
        return self.known_ranks[name]

    def hinges(self, guess: Guess) -> Hinges:
        """Where the parts of the first key frame meet."""
        rays = guess.rays
        first = rays.frame == rays.frame.min()
        point = rays.ray[first] / rays.inverse_depth[first, None]
        motion = guess.state.motions(len(guess.state.angle))
        m = inverse(motion[rays.frame.min(), rays.label[first]])
        point = np.einsum("nab,nb->na", m[:, :3, :3], point) + m[:, :3, 3]
        return Hinges(hinges(point, rays.label[first], guess.base, self.known.parent), _SLACK)

    def fitted(
        self, guess: Guess, rays: Rays, scales: tuple[float, ...], belief: float = 1.0,
        spread: float = 0.5,
    ) -> Guess:
        """M-step."""
        fit = adjust_rays(
            guess.state, rays, self.seen.intrinsics, self.known.freedom, scales, self.hinges(guess),
            belief, spread,
        )
        return replace(
            guess, state=fit.state, rays=replace(rays, inverse_depth=fit.inverse_depth),
            hessian=fit.hessian,
        )  # fmt: skip

    def settle(
        self, guess: Guess, points: Spots, rounds: int, scales: tuple[float, ...],
        belief: float = 1.0, spread: float = 0.5,
    ) -> Guess:
        """EM with the flow."""
        for _ in range(rounds):
            guess = self.fitted(guess, self.observed(guess), scales, belief, spread)
            guess = self.relabel(guess, points)
        return guess

    def sharpened(self, guess: Guess, points: Spots, rounds: int, reach: float) -> Guess:
        """M-steps with patches, which do not drift."""
        for i in range(rounds):
            rays = self.matched(guess, reach if i == 0 else _REACH, _SPAN if i else 2)
            guess = self.fitted(guess, rays, (6.0, 4.0, 3.0) if i == 0 else (3.0,) * 3)
            guess = self.relabel(guess, points)
        return replace(guess, cost=self.score(guess))

    def score(self, guess: Guess) -> float:
        """How badly the patches fit, those that are not found included."""
        rays = self.matched(guess, _REACH, _SPAN)
        away = rays.spot - places(guess.state, rays, self.seen.intrinsics)[0]
        square = np.einsum("nti,ntij,ntj->nt", away, rays.spot_information, away) / _TRUST
        found = rays.spot_information[..., 0, 0] + rays.spot_information[..., 1, 1] > 0
        cost = np.where(found, _LOST * square / (_LOST + square), _LOST)
        gap = np.abs(np.arange(cost.shape[1])[None] - rays.frame[:, None])
        return float(cost[(gap > 0) & (gap <= _SPAN)].mean())

    def extended(self, guess: Guess, until: int) -> Guess:
        """Displacements go on evenly to frame `until`."""
        angle = guess.state.angle
        more = until + 1 - len(angle)
        if more <= 0:
            return guess
        pace = (angle[-1] - angle[-min(3, len(angle))]) / (min(3, len(angle)) - 1)
        rest = angle[-1] + np.arange(1, more + 1)[:, None] * pace
        state = replace(guess.state, angle=np.concatenate([angle, rest]))
        return replace(guess, state=state)


def search_rays(seen: Footage, known: Known) -> Guess | None:
    """The best articulation; None where too little is seen to move."""
    s = Searcher(seen, known)
    last = seen.frames - 1
    many = s.points(tuple(range(0, last + 1, 2)), _MANY)
    found: list[Guess] = []
    middle = last // 4 * 2  # one of the key frames
    for key in (0, middle):
        few = s.points((key,), _FEW)
        if len(few.frame) < _FEWEST:
            continue
        some = [s.relabel(g, few) for g in beginnings(s, few, key)]
        found += [s.settle(g, few, 1, (6.0, 4.0), 1.0, 0.2) for g in distinct(some, _FIRST)]

    if not found:
        return None

    def joined(guess: Guess, rounds: int) -> Guess:
        return s.sharpened(s.settle(s.relabel(guess, many), many, 1, (6.0, 4.0)), many, rounds, 6.0)

    found = together(lambda g: joined(g, 2), found)
    found = together(lambda g: s.sharpened(g, many, 3, _REACH), distinct(found, _SECOND))
    few = s.points((middle,), _FEW)
    best = min(found, key=lambda g: g.cost)
    found += together(lambda g: joined(g, 3), traded(s, best, few, _TRADED))
    found = together(lambda g: s.sharpened(g, many, 3, _REACH), distinct(found, 2))
    return min(found, key=lambda g: g.cost)


def traded(s: Searcher, guess: Guess, points: Spots, most: int) -> list[Guess]:
    """The best solutions that share the turns of parallel neighbours otherwise (see trade.py)."""
    state, rays = guess.state, guess.rays
    if not len(points.frame):
        return []
    motion = state.motions(len(state.angle))
    mine = rays.frame == points.frame[0]
    back = inverse(motion[points.frame[0], rays.label[mine]])
    here = rays.ray[mine] / rays.inverse_depth[mine, None]
    there = np.einsum("nab,nb->na", back[:, :3, :3], here) + back[:, :3, 3]
    found: list[Guess] = []
    for j in range(s.joints - 1):
        along = float(state.twist[j, :3] @ state.twist[j + 1, :3])
        if abs(along) < _PARALLEL or not mine.any():
            continue
        hinge = spread(thinned(there, 400), _PLACES)
        first = np.stack([np.cross(state.twist[j, :3], state.twist[j, 3:]), *hinge])
        others = [shared(state, j, along, p, f) for p in hinge for f in feet(state, j, p, first)]
        others += [split(state, j, along, share) for share in _SHARES]
        found += [s.relabel(replace(guess, state=o), points) for o in others if o is not None]
    found = [s.settle(g, points, 2, (8.0, 6.0), 1.0, 0.2) for g in distinct(found, 4 * most)]
    return distinct(found, most)


def split(state: Articulation, joint: int, along: float, share: float) -> Articulation:
    """The turns of two parallel neighbours, of which the first makes `share` of what both do."""
    angle = state.angle.copy()
    both = angle[:, joint] + np.sign(along) * angle[:, joint + 1]
    angle[:, joint] = share * both
    angle[:, joint + 1] = np.sign(along) * (1 - share) * both
    return replace(state, angle=angle)


def beginnings(s: Searcher, points: Spots, key: int) -> list[Guess]:
    """First guesses from parts cut in many ways, from either end, tracked through the video."""
    out: list[Guess] = []
    seen = s.seen
    last = seen.frames - 1
    u, v = points.pixel.T
    speed = np.linalg.norm(seen.flow[max(0, key - 3) : key + 4, v, u], axis=2).mean(axis=0)
    slow = points.average(speed[:, None])[:, 0]
    start = points.ray[slow <= np.quantile(slow, 0.04)]
    directions = cycle(product(np.eye(3)[::-1], repeat=s.joints))  # where they are not known
    for _ in range(2):
        rank = order_from_base(points.ray, start)
        base = points.ray[rank <= 0.03].mean(axis=0)
        for cuts in combinations(_CUTS, s.joints - 1):
            label = 1 + np.searchsorted(np.array(cuts), rank)
            axes = next(directions)
            out.append(tracked(s, points, label, base, key, last, axes))
        start = points.ray[rank >= 0.97]
    return out


def tracked(
    s: Searcher,
    points: Spots,
    label: NDArray[np.int64],
    base: Array,
    key: int,
    last: int,
    axes: tuple[Array, ...],
) -> Guess:
    """The motion of parts [N] of a key frame that are held."""
    at = hinges(points.ray, label, base, s.known.parent)
    twist = np.stack([first_axis(s.known, j, at[j], axes[j]) for j in range(s.joints)])
    end = last if key else min(4, last)
    state = Articulation(twist, np.zeros((end + 1, s.joints)), s.known.prismatic,
                         s.known.parent)
    none = (np.zeros(0),) * 4
    rays = Rays(points.frame, points.ray, label, points.expected, points.expected, *none)
    guess = Guess(state, rays, base, np.inf, np.zeros((0, 0)))
    still = np.repeat(points.pixel[:, None].astype(np.float64), end + 1, axis=1)
    guess = s.fitted(guess, s.observed(guess, still), (20.0, 20.0, 15.0), _BELIEF, _FLAT)
    while len(guess.state.angle) <= last:
        guess = s.fitted(guess, s.observed(guess), (10.0, 6.0), _BELIEF, _FLAT)
        guess = s.extended(guess, min(last, len(guess.state.angle) + 2))
    for _ in range(4 if key else 2):
        guess = s.fitted(guess, s.observed(guess), (10.0, 6.0), _BELIEF, _FLAT)
    return guess


def first_axis(known: Known, joint: int, hinge: Array, guess: Array) -> Array:
    """[6] the axis through a hinge, if it is not known; along `guess` [3], if that is not."""
    if known.line is not None:
        return known.line[joint].copy()
    l = guess if known.direction is None else known.direction[joint]
    if known.prismatic[joint]:
        return np.concatenate([np.zeros(3), l])
    return np.concatenate([l, np.asarray(np.cross(hinge, l), np.float64)])


def distinct(found: list[Guess], most: int) -> list[Guess]:
    """The best few that differ in labels or in motion."""
    out: list[Guess] = []
    for g in sorted(found, key=lambda g: g.cost):
        if all(
            np.mean(g.rays.label != o.rays.label) > 0.05
            or np.abs(g.state.angle[-1] - o.state.angle[-1]).max() > _APART
            for o in out
        ):
            out.append(g)
        if len(out) == most:
            break
    return out
