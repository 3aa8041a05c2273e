"""Generated microwaves, dishwashers, ovens and drawers: a number decides each to the byte."""

from __future__ import annotations

from .generator import CATEGORIES, GENERATED, IDS

__all__ = ["CATEGORIES", "GENERATED", "IDS"]
