"""EM over a video without depth (Sec. 3.2 to 3.4): labels and motion by flow and by patches."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...robots.geometry import Array, inverse
from ..chain import Articulation, ChainSettings, Hinges, Known, from_axis, hinges
from ..images import Footage, order_from_base
from .bundle import adjust_rays
from .costs import flow_costs, patch_costs
from .evidence import REACH, SPAN, matched, misfit, observed
from .labels import Spots, along_tracks, disorder, labelled, spots
from .points import Rays

_TRUST = 3.0  # of patches' information: beside it, what is believed beforehand is little
_SLACK = 0.1  # how far an axis may pass from its hinge, of the distance to the camera
_FAR = 0.2  # of that distance, of an axis from its hinge: there it is doubtful
_JERKY = 30.0  # of the score, of a root mean square acceleration in rad a frame^2
_BY_PATCH = 2.0  # weight of patches beside the flow, in labels
_KEY, _FEW = 3, 100  # frames from one key frame to the next while tracking; points of each
_WIDE = 10.0  # px, from where a patch is expected in a frame that is new
_BELIEF, _LOOSE = 4.0, 0.3  # while tracking, as in `adjust_rays`


@dataclass(frozen=True)
class Guess:
    """A hypothesis: an articulation and the parts and depths of its points."""

    state: Articulation
    rays: Rays
    base: Array
    """[3] where the chain begins, at depth 1"""
    cost: float
    """What it is ranked by among others of its kind"""
    hessian: Array
    flow_cost: float = np.inf
    """Of its points under their labels, by flow"""
    disorder: float = 0.0
    """Of its labels along the chain"""
    unhinged: float = 0.0
    """How many axes pass far from where their parts begin"""

    def deviation(self) -> Array:
        """[T-1 J] standard deviations of the displacements, as far as the residuals tell."""
        held = self.state.angle[1:]
        inverse = np.linalg.inv(self.hessian + 1e-6 * np.eye(len(self.hessian)))
        return np.sqrt(np.maximum(np.diag(inverse)[: held.size], 0.0)).reshape(held.shape)


class RayTracker:
    """The footage seen by hypotheses."""

    def __init__(self, seen: Footage, known: Known) -> None:
        self.seen, self.known = seen, known
        self.joints = len(known.prismatic)
        self.spots: dict[tuple[tuple[int, ...], int], Spots] = {}
        self.known_ranks: dict[tuple[bytes, bytes], Array] = {}

    def points(self, frames: tuple[int, ...], most: int) -> Spots:
        """About `most` of each key frame."""
        if (frames, most) not in self.spots:
            self.spots[frames, most] = spots(self.seen, frames, most)
        return self.spots[frames, most]

    def relabel(self, guess: Guess, points: Spots) -> Guess:
        """E-step: the parts of `points`, which need not be the guess's own."""
        seen, state = self.seen, guess.state
        motion = state.motions(len(state.angle))
        keys, key = np.unique(points.frame, return_inverse=True)
        relative = np.stack([motion @ inverse(motion[k]) for k in keys])
        k = seen.intrinsics
        camera = float(k[0, 0]), float(k[0, 2]), float(k[1, 2])
        own = guess.rays.ray is points.ray
        depth = guess.rays.inverse_depth if own else points.expected
        depth = np.repeat(depth[:, None], self.joints, axis=1)
        by_flow = np.zeros_like(depth)
        for steps in (4, 0):  # neighbours have about one depth
            by_flow, depth = flow_costs(
                points.ray, key, depth, relative, *camera, seen.flow, seen.hold, seen.moving, steps,
            )  # fmt: skip
            if steps:
                depth = points.average(depth)
        cost = by_flow
        if own and guess.rays.spot_information.any():
            cost = cost + _BY_PATCH * patch_costs(
                points.ray, key, depth, relative, *camera,
                guess.rays.spot, guess.rays.spot_information,
            )  # fmt: skip
        there = relative[key][:, keys, 1:]
        place = np.einsum("nkjab,nb->nkja", there[..., :3], points.ray)
        place = place[..., :3] + depth[:, None, :, None] * there[..., :3, 3]
        place = k[0, 0] * place[..., :2] / np.maximum(0.05, place[..., 2:]) + k[:2, 2]
        rank = self.ranks(points, guess.base)
        label = labelled(points, along_tracks(points, cost, place), rank)
        if points.part is not None:
            label = points.part - 1
        mine = np.arange(len(label)), label
        rays = replace(
            guess.rays, frame=points.frame, ray=points.ray, label=label + 1,
            inverse_depth=depth[mine], expected=points.expected, near=points.near,
        )  # fmt: skip
        guess = replace(guess, rays=rays, cost=float(cost[mine].mean()),
                        flow_cost=float(by_flow[mine].mean()),
                        disorder=disorder(label, rank, points.frame))
        return replace(guess, unhinged=self.unhinged(guess))

    def unhinged(self, guess: Guess) -> float:
        """Of the joints that a part carries: 1 each at most, a half where an axis passes `_FAR`
        from where labels put the hinge."""
        carried = (self.known.parent >= 0) & ~self.known.prismatic
        away = from_axis(guess.state.twist, self.hinges(guess).point)[carried]
        square = (away**2).sum(axis=1)
        return float((square / (square + _FAR**2)).sum())

    def ranks(self, points: Spots, base: Array) -> Array:
        """[N] how far out each point is in its key frame."""
        name = (points.ray.tobytes(), base.tobytes())
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
        return Hinges(hinges(point, rays.label[first], guess.base, self.known.parent,
                             ChainSettings()), _SLACK)

    def fitted(
        self, guess: Guess, rays: Rays, scales: tuple[float, ...], belief: float = 1.0,
        spread: float = 0.5,
    ) -> Guess:
        """M-step."""
        trusted = replace(rays, spot_information=_TRUST * rays.spot_information)
        fit = adjust_rays(
            guess.state, trusted, self.seen.intrinsics, self.known.freedom, scales,
            self.hinges(guess), belief, spread,
        )  # fmt: skip
        return replace(
            guess, state=fit.state, rays=replace(rays, inverse_depth=fit.inverse_depth),
            hessian=fit.hessian,
        )  # fmt: skip

    def settle(
        self, guess: Guess, points: Spots, rounds: int, scales: tuple[float, ...],
        spread: float = 0.5,
    ) -> Guess:
        """EM with the flow."""
        for _ in range(rounds):
            guess = self.fitted(guess, observed(self.seen, guess.state, guess.rays), scales,
                                spread=spread)
            guess = self.relabel(guess, points)
        return guess

    def sharpened(self, guess: Guess, points: Spots, rounds: int, reach: float) -> Guess:
        """EM with patches, which do not drift; the cost is how badly these fit in the end, and how
        uneven the motion is."""
        for i in range(rounds):
            near, span = (REACH, SPAN) if i else (reach, 2)
            rays = matched(self.seen, guess.state, guess.rays, near, span)
            guess = self.fitted(guess, rays, (6.0, 4.0, 3.0) if i == 0 else (3.0,) * 3)
            guess = self.relabel(guess, points)
        pace = np.diff(guess.state.angle, 2, axis=0)
        jerky = float(np.sqrt(np.mean(pace**2))) if len(pace) else 0.0
        fit = misfit(self.seen, guess.state, guess.rays)
        return replace(guess, cost=fit + _JERKY * jerky)

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

    def followed(self, guess: Guess, until: int) -> Guess:
        """Track on to frame `until` by patches: flow sees too little motion on plain surfaces."""
        while True:
            now = len(guess.state.angle) - 1
            points = self.points(tuple(range(0, now + 1, _KEY)), _FEW)
            if guess.rays.ray is not points.ray:
                guess = self.relabel(guess, points)
            guess = self.nearer(guess, points)
            if now >= until:
                return guess
            guess = self.extended(guess, now + 1)

    def nearer(self, guess: Guess, points: Spots) -> Guess:
        """EM with patches on the frames that a guess has, which are few."""
        for reach, scales in ((_WIDE, (6.0, 4.0)), (REACH, (3.0, 3.0))):
            rays = matched(self.seen, guess.state, guess.rays, reach)
            guess = self.fitted(guess, rays, scales, _BELIEF, _LOOSE)
        return self.relabel(guess, points)
