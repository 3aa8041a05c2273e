"""Datasets in the formats of the field."""

from __future__ import annotations

from .driver import Exported, export_dataset, write_export
from .writer import SequenceRecord, Writer

__all__ = ["Exported", "SequenceRecord", "Writer", "export_dataset", "write_export"]
