"""Models by name: the robots that gcbench knows, and `microwave:17` or `partnet:7310`."""

from __future__ import annotations

from .entries import load
from .names import is_category

__all__ = ["is_category", "load"]
