"""Checks of surfaces that deform, whose flow does not follow from depth and the poses of parts.

What must hold is that the flows there and back undo each other, that visibility is what they make
it, and that nothing is unknown that could be known. Where a sequence has tracks, these tell exact
flows as well (verify_points.py).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..types import OCCLUDED, OUT_OF_IMAGE, VISIBLE, Sequence
from .checks import Check, share
from .rays import FLAT, FLOW, View, block, deforming_numbers, pixel_name

_FEW = 0.01
"""Share of pixels at which folds and edges may break a law of smooth surfaces."""


def verify_deforming(
    sequence: Sequence, t: int, here: View, there: View, forward: NDArray[np.float32],
    backward: NDArray[np.float32], visibility: NDArray[np.uint8],
) -> list[Check]:
    """Flow [N 2] from frame t and back to it, and visibility [N], at pixels of deforming parts."""
    numbers, width, height = deforming_numbers(sequence), sequence.meta.width, sequence.meta.height
    if not len(numbers):
        return []
    place = pixel_name(sequence, t)
    pixel = np.flatnonzero(np.isin(here.part, numbers) & (here.depth > 0))
    part, stored, flow = here.part[pixel], visibility[pixel], forward[pixel].T.astype(np.float64)
    known = np.isfinite(flow).all(axis=0)
    lost = np.isfinite(backward).sum(axis=-1) < 2
    there_pixel = np.flatnonzero(np.isin(there.part, numbers) & (there.depth > 0))
    checks = [
        share("deforming: flow known", ~known & (stored != OUT_OF_IMAGE), 0,
              lambda i: place(int(pixel[i]))),
        share("deforming: flow back known", lost[there_pixel], _FEW,
              lambda i: pixel_name(sequence, t + 1)(int(there_pixel[i]))),
    ]
    pixel, part, stored, flow = pixel[known], part[known], stored[known], flow[:, known]
    v, u = np.divmod(pixel, width)
    uv = np.clip(np.stack([u, v]) + flow, -1e6, 1e6)
    around = block(uv, part, there, width, height)
    # Negative inside; what is within a hundredth of a pixel of the border may be either.
    out = np.max([-0.5 - uv[0], uv[0] - width + 0.5, -0.5 - uv[1], uv[1] - height + 0.5], axis=0)
    wrong = np.where(stored == OUT_OF_IMAGE, out < -FLOW, out > FLOW)
    wrong |= (stored == VISIBLE) & ~around.same.any(axis=0) & (np.abs(out) > FLOW)
    wrong |= (stored < VISIBLE) | (stored > OUT_OF_IMAGE)
    checks.append(share("deforming: visibility", wrong, 1e-3, lambda i: place(int(pixel[i]))))

    smooth = around.far - around.near < FLAT * around.near
    inner = np.flatnonzero(around.same.all(axis=0) & smooth)
    returned = backward[around.index[:, inner]].astype(np.float64)
    mean = np.einsum("bm,bmc->mc", around.weight[:, inner], returned)
    spread = np.linalg.norm(returned - mean, axis=-1).max(axis=0)
    error = np.hypot(*(flow[:, inner] + mean.T))
    seen, usable = stored[inner], np.isfinite(error)
    astray = usable & (seen == VISIBLE) & (error > 3 * FLOW + spread)
    checks.append(share("deforming: there and back", astray, _FEW,
                        lambda i: place(int(pixel[inner[i]])), int((seen == VISIBLE).sum())))
    hidden = usable & (seen == OCCLUDED) & (error < FLOW) & (spread < FLOW)
    checks.append(share("deforming: hidden where it is seen", hidden, _FEW,
                        lambda i: place(int(pixel[inner[i]])), len(inner)))
    return checks
