"""Models that are made by code: random chains and the OWI-535 toy arm."""

from __future__ import annotations

__all__ = []
