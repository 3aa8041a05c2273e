"""Compiled loops, settings records, threads and array types."""

from __future__ import annotations

from .arrays import Image
from .compiled import compiled
from .settings import (
    DEGREE,
    Count,
    NonNegative,
    Positive,
    Scales,
    SettingsRecord,
    Share,
    Whole,
)
from .threads import together

__all__ = [
    "DEGREE", "Count", "Image", "NonNegative", "Positive", "Scales", "SettingsRecord", "Share",
    "Whole", "compiled", "together",
]
