"""Errors against properties of the truth: how far a joint moves, how much of it is visible, how
far it is. Medians in bins of equally many joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .lines import CONDITIONS, Line
from .statistics import SequenceJoint

MAX_BINS, MIN_JOINTS = 10, 4
"""Largest number of bins; number of (sequence, joint) pairs that a bin has, if there are enough."""


def error_by_condition(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return for each of CONDITIONS the bins and the median errors of the lines of one group.

    The bins are those of all pairs of the group. `at` [B] is the median of the condition in a bin,
    `pairs` [B] the number of pairs; `medians` has [B] errors for each line, None in a bin without
    one, and None for a line whose scores do not contain the condition.
    """
    return [_bins(lines, name) for name in CONDITIONS]


def _bins(lines: Sequence[Line], name: str) -> dict[str, Any]:
    known: dict[SequenceJoint, float] = {}
    for line in lines:
        known = {**line.conditions[name], **known}
    number = max(2, min(MAX_BINS, len(known) // MIN_JOINTS))
    order = sorted(known, key=lambda pair: (known[pair], pair))
    bins = [order[part[0] : part[-1] + 1]
            for part in np.array_split(np.arange(len(order)), number) if len(part)]
    return {
        "name": name,
        "at": [_short(np.median([known[pair] for pair in pairs])) for pairs in bins],
        "pairs": [len(pairs) for pairs in bins],
        "medians": [
            [_median([line.error[pair] for pair in pairs if pair in line.error]) for pairs in bins]
            if line.conditions[name] else None
            for line in lines
        ],
    }


def _median(errors: Sequence[float]) -> float | None:
    return _short(np.median(errors)) if errors else None


def _short(x: Any) -> float:
    return float(f"{float(x):.5g}")
