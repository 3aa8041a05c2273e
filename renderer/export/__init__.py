"""Datasets in the formats of the field."""

from __future__ import annotations

from .driver import export_dataset

__all__ = ["export_dataset"]
