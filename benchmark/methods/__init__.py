"""Methods by name, and the baselines."""

from __future__ import annotations

from .registry import Declaration, declare, identify, load, locate, plan_rows, split, with_options

__all__ = [
    "Declaration", "declare", "identify", "load", "locate", "plan_rows", "split", "with_options",
]
