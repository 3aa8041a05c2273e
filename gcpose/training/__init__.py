"""Training of networks. Its modules need PyTorch and are imported on use."""

from __future__ import annotations

__all__ = []
