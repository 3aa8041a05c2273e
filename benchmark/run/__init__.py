"""Evaluation: suites, isolated methods, and predictions of methods that ran elsewhere."""

from __future__ import annotations

from .driver import EvalConfig, evaluate
from .observation_files import export_observations
from .publishing import check_published, publish, rescore_published
from .submissions import ScoreConfig, score, score_predictions
from .suite import list_suites

__all__ = [
    "EvalConfig", "ScoreConfig", "check_published", "evaluate", "export_observations",
    "list_suites", "publish", "rescore_published", "score", "score_predictions",
]
