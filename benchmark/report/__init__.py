"""Results for people: leaderboard, statistics, tables, one static page."""

from __future__ import annotations

from .page import report
from .standings import standings, text

__all__ = ["report", "standings", "text"]
