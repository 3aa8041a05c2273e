"""Networks as methods: the learned baselines of the paper. Modules need PyTorch."""

from __future__ import annotations

__all__ = []
