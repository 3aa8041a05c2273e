"""Evaluation: suites, isolated methods, and predictions of methods that ran elsewhere."""

from __future__ import annotations

from .driver import EvalConfig, evaluate
from .observation_files import export_observations
from .submissions import ScoreConfig, score, score_predictions
from .suite import list_suites

__all__ = [
    "EvalConfig", "ScoreConfig", "evaluate", "export_observations", "list_suites", "score",
    "score_predictions",
]
