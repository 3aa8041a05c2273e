"""One score of each row for a whole suite: mean rank and mean error over its datasets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .labels import name_versions
from .leaderboard import Leaderboard
from .lines import Line
from .statistics import DRAWS, SEED, bootstrap_draws, percentile_interval


@dataclass(frozen=True)
class SuiteScore:
    """A row on all datasets of a suite, or on all datasets of no suite."""

    suite: str
    label: str
    """With the versions, if those of its datasets differ."""
    datasets: int
    """Number of datasets on which the row was scored."""
    of: int
    """Number of datasets of the suite in the results."""
    mean_rank: float
    """Mean of the ranks in each dataset and unit; NaN if it is not ranked in all of them."""
    mean: float
    """Mean over the datasets of the mean final errors, deg; without prismatic joints."""
    interval: tuple[float, float] | None
    """95 % interval of `mean`: bootstrap by sequence in each dataset. None if a dataset has too
    few sequences."""

    @property
    def is_complete(self) -> bool:
        """Whether the row was scored on every dataset."""
        return self.datasets == self.of


def suite_scores(board: Leaderboard) -> list[SuiteScore]:
    """Return the scores of suites of several datasets: complete rows first, by rank, then error."""
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
            scores = [_score(board, suite, label, mine, len(datasets))
                      for label, mine in rows.items()]
            out += sorted(scores, key=lambda s: (
                not s.is_complete, np.isnan(s.mean_rank), s.mean_rank, s.mean))
    return out


def _score(board: Leaderboard, suite: str, label: str, mine: list[int], of: int) -> SuiteScore:
    angles = [board.lines[k] for k in mine if board.lines[k].unit == "deg"]
    interval = None
    if angles and all(line.has_interval for line in angles):
        interval = percentile_interval(np.mean([_draws(line) for line in angles], axis=0))
    return SuiteScore(
        suite, label, len({board.lines[k].dataset for k in mine}), of,
        float(np.mean([board.ranks[k] or np.nan for k in mine])),
        float(np.mean([line.summary.mean for line in angles])) if angles else float("nan"),
        interval,
    )


def _draws(line: Line) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    seed = [SEED, *line.dataset.encode()]  # independent in each dataset
    clusters = [line.cluster[pair] for pair in line.error]
    return bootstrap_draws([*line.error.values()], clusters, np.random.default_rng(seed), DRAWS)
