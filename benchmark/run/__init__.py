"""Evaluation: suites, isolated methods, and predictions from elsewhere."""

from __future__ import annotations

from .driver import EvalConfig, evaluate
from .submissions import ScoreConfig, score_predictions

__all__ = ["EvalConfig", "ScoreConfig", "evaluate", "score_predictions"]
