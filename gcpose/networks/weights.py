"""Weights of networks from untrusted files: only tensors are read, never objects or code."""

# pyright: basic
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import ConfigError, MethodError

if TYPE_CHECKING:
    from torch import Tensor


def read_weights(path: Path, like: Mapping[str, Tensor], network: str) -> dict[str, Tensor]:
    """Read the tensors of a network from a safetensors file or a file of PyTorch.

    Args:
        path: The file. A checkpoint may hold the tensors under "state_dict".
        like: Tensors by name with the expected shapes and types; other tensors are left out.
        network: Name of the network, for messages.

    Raises:
        ConfigError: If the file cannot be read, or a tensor is missing, not finite, or has another
            shape.
        MethodError: If a package is missing.
    """
    there = read_tensors(path)
    for key, tensor in like.items():
        found = there.get(key)
        if found is None:
            raise ConfigError(f"{path}: no weights of {network}: there is no tensor {key!r}")
        if found.shape != tensor.shape:
            raise ConfigError(
                f"{path}: no weights of {network}: {key} is {list(found.shape)}, "
                f"expected {list(tensor.shape)}"
            )
        if not found.isfinite().all():
            raise ConfigError(f"{path}: {key} is not finite")
    return {key: there[key].to(tensor.dtype) for key, tensor in like.items()}


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Read all tensors of a file by name.

    Raises:
        ConfigError: If it cannot be read.
        MethodError: If a package is missing.
    """
    import torch

    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file")
    try:
        if path.suffix == ".safetensors":
            from safetensors.torch import load_file

            return load_file(path)
        tree: Any = torch.load(path, map_location="cpu", weights_only=True)
    except ImportError as error:
        raise MethodError("weights need safetensors: pip install 'gcbench[learn]'") from error
    except Exception as error:  # a damaged file, or a pickle of other objects
        reason = (str(error) or type(error).__name__).splitlines()[0][:120]
        raise ConfigError(f"{path}: holds no tensors that can be read safely ({reason})") from None
    if isinstance(tree, dict) and isinstance(tree.get("state_dict"), dict):
        tree = tree["state_dict"]
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: holds no tensors by name")
    return {str(key): value for key, value in tree.items() if isinstance(value, torch.Tensor)}
