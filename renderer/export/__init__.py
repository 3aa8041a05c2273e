"""Datasets in the formats of the field."""

from __future__ import annotations

from .driver import Format, export

__all__ = ["Format", "export"]
