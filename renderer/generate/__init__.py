"""From a configuration to a dataset: sequences rendered by processes, resumable."""

from __future__ import annotations

from .driver import generate, render_sequence

__all__ = ["generate", "render_sequence"]
