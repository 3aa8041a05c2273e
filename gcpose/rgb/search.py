"""The choice among hypotheses without depth: many ways, few survivors, what fits patches best."""

from __future__ import annotations

import numpy as np

from ..chain import Known
from ..images import Footage
from ..numerics import together
from .strategies import by_sweeps, distinct, tilted, traded
from .tracker import Guess, RayTracker

_MANY, _DENSE, _FEW = 130, 300, 220  # points of a key frame: to search, in the end, for trades
_SECOND, _TRADED, _TILTED = 6, 3, 3  # solutions that go on, or are tried otherwise
_LAST = 3  # that are fitted to the most points
_BY_FLOW = 0.2  # weight of the flow's word beside the patches'
_DISORDER = 1.5  # of parts that do not follow one another along the chain
_UNSURE = 0.1  # cost of an angle's standard deviation that is e times as large
_SURE = 0.004  # rad, below which that says nothing: a wrong motion may be as sure of itself
_UNHINGED = 0.1  # of an axis that passes far from where its part begins
_FIRST_REACH, _REACH = 6.0, 3.0  # px, from where a patch is expected


def search_rays(seen: Footage, known: Known) -> Guess | None:
    """The best articulation; None where too little is seen to move."""
    s = RayTracker(seen, known)
    last = seen.frames - 1
    keys = tuple(range(0, last + 1, 2))
    many, dense = s.points(keys, _MANY), s.points(keys, _DENSE)
    few = s.points((last // 4 * 2,), _FEW)  # one of the key frames
    found = [s.relabel(g, many) for g in by_sweeps(s)]
    if not found:
        return None
    found += [t for g in distinct(found, _TILTED) for t in tilted(g)]
    found = together(lambda g: s.sharpened(g, many, 2, _FIRST_REACH), found)
    found = together(lambda g: s.sharpened(g, many, 3, _REACH), distinct(found, _SECOND, by=judged))
    best = min(found, key=judged)
    others = traded(s, best, few, _TRADED)
    others = [s.settle(s.relabel(g, many), many, 1, (6.0, 4.0)) for g in others]
    found += together(lambda g: s.sharpened(g, many, 3, _FIRST_REACH), others)
    found = [s.relabel(g, dense) for g in distinct(found, _LAST, by=judged, differ=1.0)]
    found = together(lambda g: s.sharpened(g, dense, 3, _REACH), found)
    return min(found, key=judged)


def judged(guess: Guess) -> float:
    """By patches, which are few but do not err to one side, and by the flow; of two that explain
    both, the one whose parts are in order and turn about where they begin, and that tells every
    joint: what parts show nothing of may turn in any way."""
    unsure = float(np.log(np.maximum(guess.deviation()[-1], _SURE)).sum())
    seen = guess.cost + _BY_FLOW * guess.flow_cost
    order = _DISORDER * guess.disorder + _UNHINGED * guess.unhinged
    return seen + order + _UNSURE * unsure
