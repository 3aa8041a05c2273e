"""Results of a verification: residuals against bounds, as data and as a table."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class CheckResult:
    """One law, tested on `samples` values; it holds if the worst residual is within the bound."""

    name: str
    worst: float
    mean: float
    bound: float
    unit: str
    samples: int
    where: str = ""
    """sequence, frame and pixel (or joint, part) of the worst residual"""
    note: str = ""

    @property
    def ok(self) -> bool:
        """Whether the worst residual is within the bound; NaN is not."""
        return self.worst <= self.bound

    @property
    def excess(self) -> float:
        """The worst residual in units of the bound; more than 1 if the check fails."""
        if self.bound > 0:
            return self.worst / self.bound
        return 0.0 if self.worst == 0 else np.inf


def check(
    name: str, residuals: ArrayLike, bound: float, unit: str,
    where: Callable[[int], str] | str = "", samples: int | None = None,
) -> CheckResult:
    """Compare residuals of any shape with a bound; one that is not finite counts as infinite.

    `where` names the place of a flat index. `samples` replaces the number of residuals, where one
    stands for many.
    """
    r = np.asarray(residuals, np.float64).ravel()
    if r.size == 0:
        return CheckResult(name, 0.0, 0.0, bound, unit, samples or 0)
    r = np.where(np.isfinite(r), np.abs(r), np.inf)
    worst = int(r.argmax())
    place = where if isinstance(where, str) else where(worst)
    return CheckResult(name, float(r[worst]), float(r.mean()), bound, unit,
                       r.size if samples is None else samples, place if r[worst] > 0 else "")


def check_share(
    name: str, wrong: ArrayLike, bound: float, where: Callable[[int], str],
    samples: int | None = None, spare_chance: bool = False,
) -> CheckResult:
    """Check that at most a share `bound` of the flags `wrong` is set.

    `samples` is the number that the flags were drawn from, if only suspects are given. With
    `spare_chance`, as few as chance may set pass too.
    """
    w = np.asarray(wrong, bool).ravel()
    n, count = w.size if samples is None else samples, int(w.sum())
    part = count / n if n else 0.0
    if spare_chance and bound < part and bound * n < 10:
        bound = max(bound, _count_by_chance(bound * n) / n)
    return CheckResult(name, part, part, bound, "share", n, where(int(w.argmax())) if part else "")


def _count_by_chance(most: float) -> int:
    """The largest count that chance explains where a bound allows `most` in the mean.

    A bound is at least ten times the share that right data have. Of few samples it allows less
    than one, so a single one would break it. Counts of rare events are Poisson distributed; a
    larger count than this has a chance below 1e-6. From `most` = 10 on the bound allows more.
    """
    from scipy.special import pdtrc

    mean, count = most / 10, 0
    while pdtrc(count, mean) >= 1e-6:
        count += 1
    return count


def merge_checks(checks: Iterable[CheckResult]) -> tuple[CheckResult, ...]:
    """Merge checks of one name, in order of first appearance: the worst in units of its bound, and
    the mean over samples.
    """
    found: dict[str, CheckResult] = {}
    for new in checks:
        old = found.get(new.name)
        if old is None:
            found[new.name] = new
            continue
        n = old.samples + new.samples
        mean = (old.mean * old.samples + new.mean * new.samples) / n if n else 0.0
        worse = max(old, new, key=lambda c: (c.excess, c.worst))
        found[new.name] = replace(worse, mean=mean, samples=n)
    return tuple(found.values())


@dataclass(frozen=True)
class VerifyReport:
    """All checks of a sequence or a dataset."""

    checks: tuple[CheckResult, ...]
    warnings: tuple[str, ...] = ()
    """do not make the report wrong"""

    @property
    def ok(self) -> bool:
        """Whether all checks hold."""
        return all(c.ok for c in self.checks)

    @property
    def failures(self) -> tuple[str, ...]:
        """Names of the checks that do not hold."""
        return tuple(c.name for c in self.checks if not c.ok)

    @property
    def worst(self) -> CheckResult | None:
        """The check whose worst residual is the largest in units of its bound."""
        return max(self.checks, key=lambda c: c.excess, default=None)

    def table(self) -> str:
        """Return one line per check, then the warnings."""
        head = ("", "check", "worst", "mean", "bound", "unit", "samples", "worst at")
        rows = [("ok" if c.ok else "FAIL", c.name, f"{c.worst:.2g}", f"{c.mean:.2g}",
                 f"{c.bound:.2g}", c.unit, f"{c.samples:,}",
                 " ".join(x for x in (c.where, f"({c.note})" if c.note else "") if x))
                for c in self.checks]
        width = [max(len(r[i]) for r in (head, *rows)) for i in range(len(head) - 1)]
        left = {0, 1, 5}  # words; the rest are numbers
        lines = ["  ".join([r[i].ljust(w) if i in left else r[i].rjust(w)
                            for i, w in enumerate(width)] + [r[-1]]).rstrip()
                 for r in (head, *rows)]
        return "\n".join([*lines, *(f"warning: {w}" for w in self.warnings)])
