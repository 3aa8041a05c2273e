"""The paper's pipeline, step by step as it is written (Sec. 3).

Its methods are in `pipeline`; `fine_tune` needs PyTorch and is imported on use.
"""

from __future__ import annotations

from .pipeline import Epipolar, FlowOnly, WithDepth
from .settings import PaperSettings, PublishedSettings

__all__ = ["Epipolar", "FlowOnly", "PaperSettings", "PublishedSettings", "WithDepth"]
