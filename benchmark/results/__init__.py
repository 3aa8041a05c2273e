"""Rows of results and stored estimates."""

from __future__ import annotations

from .estimates import (
    MAX_REASON,
    STATUSES,
    InvalidEstimateError,
    Shape,
    Status,
    Stored,
    checked,
    dump_stored,
    read_stored,
)
from .rows import (
    ESTIMATES,
    INPUTS,
    KNOWLEDGE,
    RUN,
    SCORES,
    Result,
    Row,
    Run,
    RunFolder,
    find_runs,
    read_run,
    run_folder,
    write_run,
    write_scores,
)

__all__ = [
    "ESTIMATES",
    "INPUTS",
    "KNOWLEDGE",
    "MAX_REASON",
    "RUN",
    "SCORES",
    "STATUSES",
    "InvalidEstimateError",
    "Result",
    "Row",
    "Run",
    "RunFolder",
    "Shape",
    "Status",
    "Stored",
    "checked",
    "dump_stored",
    "find_runs",
    "read_run",
    "read_stored",
    "run_folder",
    "write_run",
    "write_scores",
]
