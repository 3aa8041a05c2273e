"""Checks of surfaces that deform, whose flow does not follow from depth and the poses of parts.

The flows there and back must undo each other, visibility must follow from them, and nothing that
can be known may be unknown. Where a sequence has tracks, they give exact flows as well (tracks.py).
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..types import OCCLUDED, OUT_OF_IMAGE, VISIBLE
from .checks import CheckResult, check_share
from .frames import FLAT, FLOW, FrameStep, Index, deforming_numbers

_FEW = 0.01
"""Share of pixels at which folds and edges may break a law of smooth surfaces."""
_check_share = partial(check_share, spare_chance=True)  # a small surface has few pixels


def verify_deforming(step: FrameStep) -> list[CheckResult]:
    """Check flow both ways, and visibility, at pixels of deforming parts."""
    here, there = step.here, step.there
    numbers = deforming_numbers(here.sequence)
    if not len(numbers):
        return []
    checks: list[CheckResult] = []
    if step.forward is not None and step.visibility is not None:
        pixel = np.flatnonzero(np.isin(here.part, numbers) & (here.depth > 0))
        flow, stored = step.forward[pixel].astype(np.float64), step.visibility[pixel]
        known = np.isfinite(flow).all(axis=1)
        checks += [check_share("deforming: flow known", ~known & (stored != OUT_OF_IMAGE), 0,
                               lambda i: here.name(int(pixel[i]))),
                   *_targets(step, pixel[known], flow[known].T, stored[known])]
    if step.backward is not None:
        lost = np.isfinite(step.backward).sum(axis=-1) < 2
        there_pixel = np.flatnonzero(np.isin(there.part, numbers) & (there.depth > 0))
        checks.append(_check_share("deforming: flow back known", lost[there_pixel], _FEW,
                                  lambda i: there.name(int(there_pixel[i]))))
    return checks


def _targets(
    step: FrameStep, pixel: Index, flow: Array, stored: NDArray[np.uint8]
) -> list[CheckResult]:
    """Visibility [M] of pixels [M] with a known flow [2 M], and what is where it leads."""
    here, there = step.here, step.there
    uv = np.clip(here.positions(pixel) + flow, -1e6, 1e6)
    around = there.around(uv, here.part[pixel])
    out = here.beyond_border(uv)  # within a hundredth of a pixel of the border, both are right
    wrong = np.where(stored == OUT_OF_IMAGE, out < -FLOW, out > FLOW)
    wrong |= (stored == VISIBLE) & ~around.same.any(axis=0) & (np.abs(out) > FLOW)
    wrong |= (stored < VISIBLE) | (stored > OUT_OF_IMAGE)
    checks = [_check_share("deforming: visibility", wrong, 1e-3,
                          lambda i: here.name(int(pixel[i])))]
    if step.backward is None:
        return checks

    smooth = around.far - around.near < FLAT * around.near
    inner = np.flatnonzero(around.same.all(axis=0) & smooth)
    returned = step.backward[around.index[:, inner]].astype(np.float64)
    mean = np.einsum("bm,bmc->mc", around.weight[:, inner], returned)
    spread = np.linalg.norm(returned - mean, axis=-1).max(axis=0)
    error = np.hypot(*(flow[:, inner] + mean.T))
    code, usable, place = stored[inner], np.isfinite(error), pixel[inner]
    astray = usable & (code == VISIBLE) & (error > 3 * FLOW + spread)
    checks.append(_check_share("deforming: there and back", astray, _FEW,
                              lambda i: here.name(int(place[i])), int((code == VISIBLE).sum())))
    hidden = usable & (code == OCCLUDED) & (error < FLOW) & (spread < FLOW)
    checks.append(_check_share("deforming: hidden where it is seen", hidden, _FEW,
                              lambda i: here.name(int(place[i])), len(inner)))
    return checks
