"""Rows of results and stored estimates."""

from __future__ import annotations

from .estimates import (
    MAX_REASON,
    STATUSES,
    EstimateShape,
    InvalidEstimateError,
    Status,
    Stored,
    checked,
    dump_stored,
    read_stored,
)
from .rows import INPUTS, KNOWLEDGE, Result, Row, read_scores, write_scores
from .runs import (
    ESTIMATES,
    RUN,
    SCORES,
    Results,
    Run,
    RunFolder,
    find_runs,
    read_run,
    run_folder,
    write_run,
)

__all__ = [
    "ESTIMATES",
    "INPUTS",
    "KNOWLEDGE",
    "MAX_REASON",
    "RUN",
    "SCORES",
    "STATUSES",
    "EstimateShape",
    "InvalidEstimateError",
    "Result",
    "Results",
    "Row",
    "Run",
    "RunFolder",
    "Status",
    "Stored",
    "checked",
    "dump_stored",
    "find_runs",
    "read_run",
    "read_scores",
    "read_stored",
    "run_folder",
    "write_run",
    "write_scores",
]
