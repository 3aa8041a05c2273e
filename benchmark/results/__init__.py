"""Rows of results and stored estimates."""

from __future__ import annotations

from .estimates import (
    STATUSES,
    EstimateShape,
    InvalidEstimateError,
    Status,
    Stored,
    check_start,
    dump_stored,
    read_stored,
    validate_estimate,
)
from .rows import (
    INPUTS,
    KNOWLEDGE,
    LABEL,
    Attribution,
    Result,
    Row,
    is_label,
    read_scores,
    to_table,
    write_scores,
)
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
    "ESTIMATES", "INPUTS", "KNOWLEDGE", "LABEL", "RUN", "SCORES", "STATUSES",
    "Attribution", "EstimateShape", "InvalidEstimateError", "Result", "Results", "Row", "Run",
    "RunFolder", "Status", "Stored", "check_start", "dump_stored", "find_runs", "is_label",
    "read_run", "read_scores", "read_stored", "run_folder", "to_table",
    "validate_estimate", "write_run", "write_scores",
]
