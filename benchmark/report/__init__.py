"""Results for people: leaderboard, statistics, tables, one static page."""

from __future__ import annotations

from .formats import leaderboard_records, leaderboard_text
from .leaderboard import build_leaderboard
from .page import ReportOptions, report
from .published_rows import (
    PUBLISHED_ROWS,
    PublishedRow,
    PublishedTruth,
    pack_estimates,
    pack_truth,
    published_files,
    read_row,
    read_truth,
    row_path,
    score_published,
    truth_path,
    write_record,
)

__all__ = [
    "PUBLISHED_ROWS", "PublishedRow", "PublishedTruth", "ReportOptions", "build_leaderboard",
    "leaderboard_records", "leaderboard_text", "pack_estimates", "pack_truth", "published_files",
    "read_row", "read_truth", "report", "row_path", "score_published", "truth_path", "write_record",
]
