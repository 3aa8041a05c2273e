"""Weights of networks in files, which may come from anywhere: tensors are read, never programs."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import GcbenchError

if TYPE_CHECKING:
    from torch import Tensor


def read_weights(path: Path, like: Mapping[str, Tensor], network: str) -> dict[str, Tensor]:
    """The tensors of a safetensors file, or of PyTorch's own format, that fit those of a network.

    A checkpoint that holds them under "state_dict" is opened, and what `like` does not know is
    left out. Raises GcbenchError if the file cannot be read, or lacks a tensor or has it in
    another shape; the message names the first.
    """
    there = read_tensors(path)
    for key, tensor in like.items():
        found = there.get(key)
        if found is None:
            raise GcbenchError(f"{path}: no weights of {network}: there is no tensor {key!r}")
        if found.shape != tensor.shape:
            raise GcbenchError(
                f"{path}: no weights of {network}: {key} is {list(found.shape)}, "
                f"expected {list(tensor.shape)}"
            )
        if not found.isfinite().all():
            raise GcbenchError(f"{path}: {key} is not finite")
    return {key: there[key].to(tensor.dtype) for key, tensor in like.items()}


def read_tensors(path: Path) -> dict[str, Tensor]:
    """All tensors of a file by name. Raises GcbenchError if it cannot be read."""
    import torch

    if not path.is_file():
        raise GcbenchError(f"{path}: there is no such file")
    try:
        if path.suffix == ".safetensors":
            from safetensors.torch import load_file

            return load_file(path)
        tree: Any = torch.load(path, map_location="cpu", weights_only=True)
    except ImportError as error:
        raise GcbenchError("weights need safetensors: pip install 'gcbench[learn]'") from error
    except Exception as error:  # damaged in any of many ways, or a pickle of more than tensors
        reason = (str(error) or type(error).__name__).splitlines()[0][:120]
        raise GcbenchError(f"{path}: holds no tensors that can be read safely ({reason})") from None
    if isinstance(tree, dict) and isinstance(tree.get("state_dict"), dict):
        tree = tree["state_dict"]
    if not isinstance(tree, dict):
        raise GcbenchError(f"{path}: holds no tensors by name")
    return {str(key): value for key, value in tree.items() if isinstance(value, torch.Tensor)}
