"""Old place of `gcbench.renderer.dataset.torch`. Goes with version 0.3."""

import warnings

from .dataset.torch import TorchDataset

__all__ = ["TorchDataset"]

warnings.warn("gcbench.renderer.torch_dataset has moved to gcbench.renderer.dataset.torch",
              DeprecationWarning, stacklevel=2)
