"""Errors of a flow on moving parts, by pixel and by part."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..images import Flow
from .pairs import STATIC_MOTION, FramePair

_MIN_PIXELS = 40  # of a part whose bias counts, at any resolution


@dataclass(frozen=True)
class FlowErrors:
    """Errors over the moving parts of all pairs, px, without occluded pixels."""

    epe: float
    """Mean end-point error over the pixels."""
    median: float
    bias: float
    """Length of the mean error vector over a part's pixels, mean over the parts."""
    bias_by_size: float
    """The same, weighted by the parts' pixels."""
    speed: float
    """Mean length of the true flow: the error of zero flow."""
    pairs: int
    parts: int


def flow_errors(flows: Mapping[str, Flow], pairs: Iterable[FramePair]) -> dict[str, FlowErrors]:
    """Return the errors of flows by name, all on the same pairs."""
    lengths: dict[str, list[float]] = {name: [] for name in flows}
    pixels = {name: list[np.ndarray]() for name in flows}
    speeds: list[np.ndarray] = []
    sizes: list[int] = []
    count = 0
    for pair in pairs:
        count += 1
        known = np.isfinite(pair.flow).all(axis=2) & pair.seen & (pair.part > 0)
        speed = np.linalg.norm(pair.flow, axis=2)
        masks = [known & (pair.part == p) for p in np.unique(pair.part[known])]
        masks = [m for m in masks if m.sum() >= _MIN_PIXELS and speed[m].mean() > STATIC_MOTION]
        sizes += [int(m.sum()) for m in masks]
        speeds += [speed[m] for m in masks]
        for name, flow in flows.items():
            error = flow(pair.a, pair.b) - pair.flow
            for m in masks:
                lengths[name].append(float(np.linalg.norm(error[m].mean(axis=0))))
                pixels[name].append(np.linalg.norm(error[m], axis=1))
    if not sizes:
        nan = float("nan")
        return {name: FlowErrors(nan, nan, nan, nan, nan, count, 0) for name in flows}
    out: dict[str, FlowErrors] = {}
    for name in flows:
        every = np.concatenate(pixels[name])
        out[name] = FlowErrors(
            epe=float(every.mean()),
            median=float(np.median(every)),
            bias=float(np.mean(lengths[name])),
            bias_by_size=float(np.average(lengths[name], weights=sizes)),
            speed=float(np.concatenate(speeds).mean()),
            pairs=count,
            parts=len(sizes),
        )
    return out
