"""From a configuration to a dataset: sequences rendered by processes, resumable."""

from __future__ import annotations

from .driver import render_dataset, render_sequence
from .streaming import stream

__all__ = ["render_dataset", "render_sequence", "stream"]
