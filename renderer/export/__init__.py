"""Datasets in the formats of the field."""

from __future__ import annotations

from .driver import export

__all__ = ["export"]
