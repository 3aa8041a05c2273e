"""Evaluation: suites, isolated methods, and predictions of methods that ran elsewhere."""

from __future__ import annotations

from .driver import EvalConfig, evaluate
from .submissions import ScoreConfig, score, score_predictions

__all__ = ["EvalConfig", "ScoreConfig", "evaluate", "score", "score_predictions"]
