"""Images as networks take them."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray


def unit(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Grey levels as 0..1."""
    return np.multiply(image, 1 / 255, dtype=np.float32)


def padded(image: NDArray[np.float32], multiple: int) -> torch.Tensor:
    """[1 C H' W'] of an image [H W C], its edge repeated to whole multiples."""
    below, right = -image.shape[0] % multiple, -image.shape[1] % multiple
    whole = np.pad(image, ((0, below), (0, right), (0, 0)), mode="edge")
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(whole, 2, 0)))[None]
