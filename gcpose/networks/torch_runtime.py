"""PyTorch if it is installed, its devices, and images as tensors."""

# pyright: basic
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, MethodError

try:
    import torch
    import torch.nn.functional as F  # noqa: N812
    from torch import Tensor, nn
except ImportError as error:
    raise MethodError("a network needs PyTorch: pip install '.[learn]'") from error

__all__ = ["F", "Tensor", "find_device", "nn", "pad_image", "torch", "unit_range", "warp_image"]


def find_device(name: str) -> torch.device:
    """Return the device "cpu", "cuda", "mps", ...; "auto" is "cuda" if there is one, else "cpu".

    Raises:
        ConfigError: If this machine has no such device.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        return torch.zeros(1, device=name).device
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"--device {name}: {reason}; cpu works everywhere") from error


def unit_range(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return an image of 8 bits with values in 0..1."""
    return np.multiply(image, 1 / 255, dtype=np.float32)


def pad_image(image: NDArray[np.float32], multiple: int, min_side: int = 1) -> torch.Tensor:
    """Return a tensor [1 C H' W'] of an image [H W C], its edge repeated to multiples of a size.

    No side is less than `min_side`, px.
    """
    height, width = (max(side, min_side) for side in image.shape[:2])
    below = height + -height % multiple - image.shape[0]
    right = width + -width % multiple - image.shape[1]
    whole = np.pad(image, ((0, below), (0, right), (0, 0)), mode="edge")
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(whole, 2, 0)))[None]


def warp_image(image: torch.Tensor, flow: torch.Tensor) -> torch.Tensor:
    """Return the image [B C H W] sampled at x + flow(x) [B 2 H W] px, its edge repeated outside."""
    _, _, h, w = image.shape
    v, u = torch.meshgrid(
        torch.arange(h, device=flow.device), torch.arange(w, device=flow.device), indexing="ij"
    )
    x = 2 * (u + flow[:, 0]) / max(w - 1, 1) - 1
    y = 2 * (v + flow[:, 1]) / max(h - 1, 1) - 1
    return F.grid_sample(image, torch.stack([x, y], -1), padding_mode="border", align_corners=True)
