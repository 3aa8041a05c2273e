"""Datasets in the formats of the field."""

from __future__ import annotations

from .driver import Exported, export_dataset, write_export
from .rerun_viewer import open_rerun, record_for_rerun
from .writer import SequenceRecord, Writer

__all__ = [
    "Exported", "SequenceRecord", "Writer", "export_dataset", "open_rerun", "record_for_rerun",
    "write_export",
]
