"""Ways to an articulation without depth: many first guesses, tracked through the video."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...robots.geometry import Array, inverse
from ..chain import Articulation, spread, thinned, unlike
from ..images import order_from_base
from ..numerics import together
from .flow_sweep import swept_rays
from .labels import Spots
from .parallel_axes import feet, shared
from .points import Rays
from .tracker import Guess, RayTracker

_FEW, _FEWEST = 220, 20  # points of a key frame, and that are worth a search
_SPANS, _SWEPT = (2, 3), 30  # frames that sweeps look ahead, and what is kept of each
_BEGUN, _HALFWAY, _ALL = 40, 24, 10  # that go on to the next stage
_HALF = 8  # frames after which the worse are left
_APART = 0.07, 0.2  # of two guesses, rad or m: while there are many, and in the end
_DIFFER = 0.05  # share of the labels in which two guesses are unlike
_PARALLEL, _PLACES = 0.98, 16  # cosine; where a hinge may be
_TILTS, _SEEN_ALONG = 8, 0.15  # planes through a door's axis; sine that they are seen at
_SHARES = (-1.5, -0.75, 0.0, 0.5, 1.0, 1.75, 2.5)


def by_sweeps(s: RayTracker) -> list[Guess]:
    """From joints' first steps (see beam.py), tracked frame by frame."""
    last = s.seen.frames - 1
    points = s.points((0,), _FEW)
    if len(points.frame) < _FEWEST:
        return []
    spans = sorted({min(span, last) for span in _SPANS})
    found = [g for some in together(lambda span: swept(s, points, span), spans) for g in some]
    start = min(max(spans) + 1, last)
    found = together(lambda g: s.nearer(s.extended(g, start), points),
                     distinct(found, _BEGUN, _APART[0]))
    found = together(lambda g: s.followed(g, min(_HALF, last)),
                     distinct(found, _HALFWAY, _APART[0]))
    return together(lambda g: s.followed(g, last), distinct(found, _ALL, _APART[0]))


def swept(s: RayTracker, points: Spots, to: int) -> list[Guess]:
    """The best chains over frames 0 and `to`, with labels from either end."""
    beam = unlike(swept_rays(s.seen, s.known, points, to), _SWEPT)
    one = np.ones(len(points.frame), np.int64)
    rays = Rays.unseen(points.frame, points.ray, one, points.expected)
    bases, out = ends(s, points, 0), list[Guess]()
    for twist, end in zip(beam.twist, beam.angle, strict=True):
        angle = np.linspace(0 * end, end, to + 1)
        state = Articulation(twist, angle, s.known.prismatic, s.known.parent)
        out += [s.relabel(Guess(state, rays, base, np.inf, np.zeros((0, 0))), points)
                for base in bases]
    return out


def ends(s: RayTracker, points: Spots, key: int) -> list[Array]:
    """[3] each, at depth 1: where the chain begins, or may in a key frame, what is slow first."""
    if s.known.base is not None:
        return [s.known.base]
    u, v = points.pixel.T
    speed = np.linalg.norm(s.seen.flow[max(0, key - 3) : key + 4, v, u], axis=2).mean(axis=0)
    slow = points.average(speed[:, None])[:, 0]
    start, out = points.ray[slow <= np.quantile(slow, 0.04)], []
    for _ in range(2):
        rank = order_from_base(points.ray, start)
        out.append(points.ray[rank <= 0.03].mean(axis=0))
        start = points.ray[rank >= 0.97]
    return out


def traded(s: RayTracker, guess: Guess, points: Spots, most: int) -> list[Guess]:
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
    found = [s.settle(g, points, 2, (8.0, 6.0), 0.2) for g in distinct(found, 4 * most)]
    return distinct(found, most)


def tilted(guess: Guess) -> list[Guess]:
    """The same motion of a door, whose points lie in a plane through its axis: each way it may lie.

    How a door lies and how far it turns explain each other; from points at one distance the search
    ends in the nearest of several minima.
    """
    twist, motion = guess.state.twist[0], guess.state.motions(len(guess.state.angle))
    foot = np.asarray(np.cross(twist[:3], twist[3:]), np.float64)
    if guess.state.prismatic[0] or len(guess.state.twist) > 1 or not foot.any():
        return []
    ray, out = guess.rays.ray, list[Guess]()
    one, other = np.linalg.svd(twist[None, :3])[2][1:]
    for turn in (np.arange(_TILTS) + 0.5) * np.pi / _TILTS:
        across = np.cos(turn) * one + np.sin(turn) * other
        toward = np.einsum("nab,b,na->n", motion[guess.rays.frame, 1, :3, :3], across, ray)
        depth = toward / (across @ foot)
        scale = float(depth.mean())
        seen = np.abs(toward) > _SEEN_ALONG * np.linalg.norm(ray, axis=1)
        if not 0.3 < scale < 3.0 or seen.mean() < 0.5 or np.mean(depth > 0) < 0.9:
            continue
        line = np.concatenate([twist[:3], scale * twist[3:]])[None]
        rays = replace(guess.rays, inverse_depth=np.clip(depth / scale, 0.4, 2.5))
        out.append(replace(guess, state=replace(guess.state, twist=line), rays=rays))
    return out


def split(state: Articulation, joint: int, along: float, share: float) -> Articulation:
    """The turns of two parallel neighbours, of which the first makes `share` of what both do."""
    angle = state.angle.copy()
    both = angle[:, joint] + np.sign(along) * angle[:, joint + 1]
    angle[:, joint] = share * both
    angle[:, joint + 1] = np.sign(along) * (1 - share) * both
    return replace(state, angle=angle)


def distinct(
    found: list[Guess], most: int, apart: float = _APART[1],
    by: Callable[[Guess], float] = lambda g: g.cost, differ: float = _DIFFER,
) -> list[Guess]:
    """The best few that differ in more than a share of the labels, or in motion."""
    out: list[Guess] = []
    for g in sorted(found, key=by):
        if all(
            np.mean(g.rays.label != o.rays.label) > differ
            or np.abs(g.state.angle[-1] - o.state.angle[-1]).max() > apart
            for o in out
        ):
            out.append(g)
        if len(out) == most:
            break
    return out
