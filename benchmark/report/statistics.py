"""Means over many sequences with their uncertainty: pure functions of arrays.

N values, one for each (sequence, joint); `cluster` [N] says what was drawn independently: the
sequence, or the object's instance. Randomness is an argument; every list keeps its order.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...robots.geometry import Array

DRAWS = 2000
"""Draws of a bootstrap."""
SEED = 0
"""Seed of the bootstrap: a table is a function of its results."""
MIN_CLUSTERS = 5
"""Smallest number of sequences (or objects) of an interval; fewer say too little."""
EXACT_CLUSTERS = 12
"""Largest number of sequences (or objects) for which a test takes all changes of signs."""
FLIPS = 9999
"""Random changes of signs of a test of more of them."""
_LEVEL = 0.95
_SIGNIFICANT = 0.05
"""A difference is significant if the p of its test is smaller."""
_AT_ONCE = 2**21  # drawn numbers in memory
_ROUNDING = 2e-5
"""Differences below this, deg or m, are none: published errors are rounded."""


SequenceJoint = tuple[str, str]
"""Key of a scored pair: (sequence, joint)."""


@dataclass(frozen=True)
class ErrorSummary:
    """Errors of one row on one dataset, in one unit."""

    sequences: int
    joints: int
    """(sequence, joint) pairs."""
    mean: float
    std: float
    """Of the pairs."""
    ci_low: float
    ci_high: float
    """95 % interval of the mean, bootstrap by cluster."""
    median: float
    p90: float
    pcp: tuple[float, ...]
    """Percent, for each threshold."""
    coverage: float
    """Percent of the pairs with an estimate."""


def summarize(
    error: ArrayLike,
    covered: ArrayLike,
    cluster: Sequence[Hashable],
    sequence: Sequence[Hashable],
    thresholds: Sequence[float],
    rng: np.random.Generator,
) -> ErrorSummary:
    """Summarize errors [N] >= 0 with coverage [N]; thresholds are in the unit of the errors.

    A pair without an estimate is in every number, with the error of no motion, and is wrong for
    PCP. Raises ValueError if an error is not finite: no mean omits a pair.
    """
    e, c = np.asarray(error, np.float64), np.asarray(covered, bool)
    if e.ndim != 1 or not e.size or not np.isfinite(e).all() or e.shape != c.shape:
        raise ValueError("errors are finite numbers, at least one, each with its coverage")
    low, high = bootstrap_mean(e, cluster, rng)
    return ErrorSummary(
        sequences=len(set(sequence)),
        joints=len(e),
        mean=float(e.mean()),
        std=float(e.std()),
        ci_low=low,
        ci_high=high,
        median=float(np.median(e)),
        p90=float(np.percentile(e, 90)),
        pcp=pcp(e, c, thresholds),
        coverage=100.0 * float(c.mean()),
    )


def pcp(error: Array, covered: NDArray[np.bool_], thresholds: Sequence[float]) -> tuple[float, ...]:
    """Percent of all N pairs whose error [N] is at most each threshold and that are covered [N]."""
    return tuple(
        100.0 * float(((error <= limit * (1 + 1e-9)) & covered).mean()) for limit in thresholds
    )


def bootstrap_draws(
    value: ArrayLike, cluster: Sequence[Hashable], rng: np.random.Generator, draws: int = DRAWS
) -> Array:
    """Return the means [draws] of [N] values when whole clusters are drawn again."""
    v = np.asarray(value, np.float64)
    number = {key: k for k, key in enumerate(dict.fromkeys(cluster))}
    which = np.array([number[key] for key in cluster])
    sums, counts = np.bincount(which, v), np.bincount(which).astype(np.float64)
    n = len(number)
    means = np.empty(draws)
    chunk = max(1, _AT_ONCE // n)
    for k in range(0, draws, chunk):
        drawn = rng.integers(0, n, (min(chunk, draws - k), n))
        means[k : k + chunk] = sums[drawn].sum(1) / counts[drawn].sum(1)
    return means


def percentile_interval(draws: Array) -> tuple[float, float]:
    """Return the 95 % interval of drawn numbers."""
    low, high = np.percentile(draws, [50.0 * (1.0 - _LEVEL), 50.0 * (1.0 + _LEVEL)])
    return float(low), float(high)


def bootstrap_mean(
    value: ArrayLike, cluster: Sequence[Hashable], rng: np.random.Generator, draws: int = DRAWS
) -> tuple[float, float]:
    """Return the 95 % interval of the mean of [N] values; see `bootstrap_draws`."""
    return percentile_interval(bootstrap_draws(value, cluster, rng, draws))


@dataclass(frozen=True)
class Difference:
    """Two rows on the same (sequence, joint) pairs: a - b."""

    pairs: int
    clusters: int
    mean: float
    ci_low: float
    ci_high: float
    p: float = 1.0
    """Of the test that the mean is zero, see `sign_flip_test`."""

    @property
    def is_significant(self) -> bool:
        """Whether the test rejects that the mean is zero; up to five clusters cannot do so."""
        return self.p < _SIGNIFICANT


def paired_difference(
    a: Mapping[SequenceJoint, float],
    b: Mapping[SequenceJoint, float],
    rng: np.random.Generator,
    cluster: Mapping[SequenceJoint, Hashable] | None = None,
) -> Difference:
    """Compare a - b on common pairs, with the interval by cluster (default: the sequence)."""
    common = sorted(a.keys() & b.keys())
    if not common:
        return Difference(0, 0, float("nan"), float("nan"), float("nan"))
    delta = np.array([a[pair] - b[pair] for pair in common])
    delta[np.abs(delta) < _ROUNDING] = 0.0
    groups = [(cluster or {}).get(p, p[0]) for p in common]
    low, high = bootstrap_mean(delta, groups, rng)
    p = sign_flip_test(delta, groups)
    return Difference(len(common), len(set(groups)), float(delta.mean()), low, high, p)


def sign_flip_test(value: ArrayLike, cluster: Sequence[Hashable]) -> float:
    """Return the two-sided p of the test that [N] values have the mean zero.

    If two rows are equally good, the differences of a cluster have either sign with the same
    probability: p is the share of the changes of the signs of whole clusters with a mean as far
    from zero. All 2^n are taken for up to EXACT_CLUSTERS clusters, else FLIPS random ones, which
    depend on nothing but n, and the observed one.
    """
    number = {key: k for k, key in enumerate(dict.fromkeys(cluster))}
    sums = np.bincount([number[key] for key in cluster], np.asarray(value, np.float64))
    n = len(sums)
    least = abs(float(sums.sum())) - 1e-12 * float(np.abs(sums).sum())  # rounding is no difference
    if n <= EXACT_CLUSTERS:
        flips = np.arange(2**n)[:, None] >> np.arange(n) & 1
        return float((np.abs((1 - 2 * flips) @ sums) >= least).mean())
    rng, found = np.random.default_rng(SEED), 1
    chunk = max(1, _AT_ONCE // n)
    for k in range(0, FLIPS, chunk):
        flips = rng.integers(0, 2, (min(chunk, FLIPS - k), n), np.int8)
        found += int((np.abs((1.0 - 2.0 * flips) @ sums) >= least).sum())
    return found / (FLIPS + 1)


def compare_rows(
    rows: Sequence[tuple[Mapping[SequenceJoint, float], Mapping[SequenceJoint, Hashable]]],
    seed: int = SEED,
) -> dict[tuple[int, int], Difference]:
    """Return the difference a - b of rows a < b, given as errors and clusters of their pairs, where
    they share enough clusters. The order of the rows does not change the random draws."""
    seed = int(np.random.default_rng(seed).integers(2**63))
    found: dict[tuple[int, int], Difference] = {}
    for b, (second, _) in enumerate(rows):
        for a, (first, cluster) in enumerate(rows[:b]):
            difference = paired_difference(first, second, np.random.default_rng(seed), cluster)
            if difference.clusters >= MIN_CLUSTERS:
                found[a, b] = difference
    return found


def shared_ranks(
    number: int, differences: Mapping[tuple[int, int], Difference],
    uncounted: Collection[int] = (),
) -> list[int]:
    """Return the rank of each of `number` rows: 1 + the number of significantly better rows.

    Rows that are `uncounted` have a rank, but no other row loses one to them.
    Two rows without a significant difference can have different ranks, where a third row is better
    than one of them only. There is no correction for the number of comparisons.
    """
    ranks = [1] * number
    for (a, b), difference in differences.items():
        worse, better = (a, b) if difference.mean > 0.0 else (b, a)
        if difference.is_significant and better not in uncounted:
            ranks[worse] += 1
    return ranks


def best_half(error: ArrayLike) -> float:
    """Return the mean of the better half of [N] errors (rounded up): CRAVES' published metric.

    It selects by the true error and is shown only beside CRAVES' number."""
    e = np.sort(np.asarray(error, np.float64))
    return float(e[: (len(e) + 1) // 2].mean())
