"""The paper's pipeline, step by step as it is written (Sec. 3).

Its methods are in `pipeline`; `fine_tune` needs PyTorch and is imported on use.
"""

from __future__ import annotations

__all__ = []
