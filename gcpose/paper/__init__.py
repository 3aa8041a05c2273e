"""The paper's pipeline, step by step as it is written (Sec. 3)."""

from __future__ import annotations

__all__ = []
