"""One score of each row for a whole suite: mean rank and mean error over its datasets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ...errors import ConfigError
from ...renderer.runtime import parse_toml
from ...robots.files import read_bounded
from .labels import name_versions
from .leaderboard import Leaderboard
from .lines import Line
from .statistics import DRAWS, SEED, bootstrap_draws, percentile_interval

_RECIPES = Path(__file__).parents[1] / "suites"


@dataclass(frozen=True)
class SuiteScore:
    """A row on the datasets of a suite, or on all datasets of no suite."""

    suite: str
    label: str
    """With the versions, if those of its datasets differ."""
    datasets: int
    """Number of datasets on which the row was scored."""
    of: int
    """Number of datasets of the suite; of those in the results, if no suite of gcbench has its
    name."""
    mean_rank: float
    """Mean of the ranks in each dataset and unit; NaN if it is not ranked in all of them."""
    mean: float
    """Mean over the datasets of the mean final errors, deg; without prismatic joints."""
    interval: tuple[float, float] | None
    """95 % interval of `mean`: bootstrap by sequence in each dataset. None if a dataset has too
    few sequences. Datasets that are twins get equal draws."""
    best_sign: bool
    """Whether a joint of a dataset has the sign with the smaller error."""

    @property
    def is_complete(self) -> bool:
        """Whether the row was scored on every dataset."""
        return self.datasets == self.of


@cache
def suite_sizes() -> dict[str, int]:
    """Return the number of datasets of each suite of gcbench by its name in results."""
    sizes: dict[str, int] = {}
    for path in _RECIPES.glob("*.toml"):
        tree = parse_toml(read_bounded(path, 2**20, ConfigError), str(path))
        version = tree.get("version", 1)
        sizes[path.stem + f"-{version}" * (version > 1)] = len(tree["dataset"])
    return sizes


def suite_scores(board: Leaderboard) -> list[SuiteScore]:
    """Return the scores of suites of several datasets: by datasets, then rank, then error."""
    members: dict[str, list[int]] = {}
    for k, line in enumerate(board.lines):
        members.setdefault(line.dataset.rpartition("/")[0], []).append(k)
    all_labels = board.labels
    out: list[SuiteScore] = []
    for suite, all_mine in members.items():
        labels = name_versions([board.lines[k].row for k in all_mine],
                               [all_labels[k] for k in all_mine])
        rows: dict[str, list[int]] = {}
        for k, label in zip(all_mine, labels, strict=True):
            rows.setdefault(label, []).append(k)
        datasets = {board.lines[k].dataset for mine in rows.values() for k in mine}
        if len(datasets) > 1:
            of = suite_sizes().get(suite, len(datasets))
            scores = [_score(board, suite, label, mine, of) for label, mine in rows.items()]
            out += sorted(scores, key=lambda s: (
                -s.datasets, np.isnan(s.mean_rank), s.mean_rank, s.mean))
    return out


def _score(board: Leaderboard, suite: str, label: str, mine: list[int], of: int) -> SuiteScore:
    angles = [board.lines[k] for k in mine if board.lines[k].unit == "deg"]
    interval = None
    if angles and all(line.has_interval for line in angles):
        interval = percentile_interval(np.mean([_draws(line, angles) for line in angles], axis=0))
    return SuiteScore(
        suite, label, len({board.lines[k].dataset for k in mine}), of,
        float(np.mean([board.ranks[k] or np.nan for k in mine])),
        float(np.mean([line.summary.mean for line in angles])) if angles else float("nan"),
        interval,
        any(board.lines[k].best_sign for k in mine),
    )


def _draws(
    line: Line, others: Sequence[Line]
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the drawn means of a line: independent of other datasets, except of a twin."""
    twins = [other.dataset for other in others if _are_twins(line, other)]
    seed = [SEED, *min([line.dataset, *twins]).encode()]
    clusters = [line.cluster[pair] for pair in line.error]
    return bootstrap_draws([*line.error.values()], clusters, np.random.default_rng(seed), DRAWS)


def _are_twins(one: Line, other: Line) -> bool:
    """Whether two lines are on the same sequences of datasets with the same random draws."""
    a, b = one.run.run.config, other.run.run.config
    same = all(a.get(name) == b.get(name) for name in ("twin_of", "seed", "stream"))
    return bool(a.get("twin_of")) and same and one.sequences == other.sequences
