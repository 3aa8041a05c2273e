"""What a flow is to the estimators."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Flow(Protocol):
    """A learned flow, or a classical one."""

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """[H W 2] displacement (du, dv), px, of each pixel of image a [H W 3] to image b."""
        ...
