"""Old place of what a method sees and returns: import it from `gcbench`. Goes with version 0.3."""

import warnings

from .types import Estimate, Inputs, Knowledge, Method, Observation

__all__ = ["Estimate", "Inputs", "Knowledge", "Method", "Observation"]

warnings.warn("gcbench.renderer.observation has moved: import these names from gcbench",
              DeprecationWarning, stacklevel=2)
