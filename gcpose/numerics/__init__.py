"""Compiled loops, threads and array types."""

from __future__ import annotations

from .arrays import Image
from .compiled import compiled
from .threads import together

__all__ = ["Image", "compiled", "together"]
