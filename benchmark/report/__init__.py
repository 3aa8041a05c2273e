"""Results for people: leaderboard, statistics, tables, one static page."""

from __future__ import annotations

from .formats import leaderboard_records, leaderboard_text
from .leaderboard import build_leaderboard
from .page import report

__all__ = ["build_leaderboard", "leaderboard_records", "leaderboard_text", "report"]
