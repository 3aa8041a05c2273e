"""Types of arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
"""An array [H W] or [H W C] of single precision."""
