"""Results for people: leaderboard, statistics, tables, one static page."""

from __future__ import annotations

from .formats import leaderboard_text
from .page import report

__all__ = ["leaderboard_text", "report"]
