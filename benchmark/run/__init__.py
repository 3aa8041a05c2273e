"""Evaluation: suites, isolated methods, and predictions of methods that ran elsewhere."""

from __future__ import annotations

from .driver import EvalConfig, evaluate
from .observation_files import export_observations
from .submissions import ScoreConfig, score, score_predictions
from .suite import suites_table

__all__ = [
    "EvalConfig", "ScoreConfig", "evaluate", "export_observations", "score", "score_predictions",
    "suites_table",
]
