"""Weights of networks and checkpoints of training in files.

Files may come from anywhere: only tensors are read, never objects or code.
"""

# pyright: basic
from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save

from ...errors import ConfigError
from ...robots.files import write_atomically
from .torch_runtime import Tensor, nn, torch

_CHECKPOINT = "checkpoint.safetensors"


def read_weights(path: Path, like: Mapping[str, Tensor], network: str) -> dict[str, Tensor]:
    """Read the tensors of a network from a safetensors file or a file of PyTorch.

    Args:
        path: The file. A checkpoint may hold the tensors under "state_dict".
        like: Tensors by name with the expected shapes and types; other tensors are left out.
        network: Name of the network, for messages.

    Raises:
        ConfigError: If the file cannot be read, or a tensor is missing, not finite, or has another
            shape.
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
    """
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file")
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        tree: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged file, or a pickle of other objects
        reason = (str(error) or type(error).__name__).splitlines()[0][:120]
        raise ConfigError(f"{path}: holds no tensors that can be read safely ({reason})") from None
    if isinstance(tree, dict) and isinstance(tree.get("state_dict"), dict):
        tree = tree["state_dict"]
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: holds no tensors by name")
    return {str(key): value for key, value in tree.items() if isinstance(value, Tensor)}


def read_notes(path: Path) -> dict[str, str]:
    """Read the notes that `write_weights` put into a safetensors file.

    Raises:
        ConfigError: If the file cannot be read.
    """
    try:
        with safe_open(path, framework="pt") as file:
            return dict(file.metadata() or {})
    except (OSError, SafetensorError) as error:
        reason = str(error).splitlines()[0][:120]
        raise ConfigError(f"{path}: no safetensors file ({reason})") from None


def write_weights(
    path: Path, network: nn.Module, notes: Mapping[str, str] | None = None, half: bool = False
) -> None:
    """Write the tensors of a network, and notes on them, to a safetensors file, atomically.

    Equal tensors and notes give equal files; a file that holds them is not written again. With
    `half`, filters and matrices are written in half precision.
    """
    large = {k for k, p in network.named_parameters() if half and p.ndim > 1}
    tensors = {k: v.half() if k in large else v for k, v in network.state_dict().items()}
    _write_tensors(path, tensors, notes)


def _write_tensors(
    path: Path, tensors: dict[str, Tensor], notes: Mapping[str, str] | None = None
) -> None:
    data = _sort_notes(save({k: v.detach().cpu().contiguous() for k, v in tensors.items()},
                            dict(notes) if notes else None))
    try:  # safetensors would raise an error of its own on a full disk
        if not (path.is_file() and path.read_bytes() == data):
            write_atomically(path, data)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error


def _sort_notes(data: bytes) -> bytes:
    """Return a safetensors file with its notes in order: safetensors writes them in any."""
    end = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:end])
    if "__metadata__" not in header:
        return data
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + data[end:]


@dataclass(frozen=True)
class Checkpoint:
    """Progress of a training run."""

    step: int
    """Steps that are done"""
    seconds: float
    """Time that they took"""


def _moments(optimizer: torch.optim.Optimizer) -> tuple[str, ...]:
    """Return what an optimizer keeps of each parameter that has learned."""
    rms = isinstance(optimizer, torch.optim.RMSprop)
    return ("step", "square_avg") if rms else ("step", "exp_avg", "exp_avg_sq")


def write_checkpoint(
    folder: Path, network: nn.Module, optimizer: torch.optim.Optimizer, at: Checkpoint
) -> None:
    """Write the state of a network and of Adam, AdamW or RMSprop."""
    tensors = {f"network/{key}": value for key, value in network.state_dict().items()}
    for name, parameter in network.named_parameters():
        state = optimizer.state.get(parameter, {})  # none while the parameter is kept as it is
        tensors |= {f"{key}/{name}": state[key] for key in _moments(optimizer) if key in state}
    tensors["at"] = torch.tensor([at.step, at.seconds], dtype=torch.float64)
    _write_tensors(folder / _CHECKPOINT, tensors)


def has_checkpoint(folder: Path) -> bool:
    """Return whether a folder holds a run."""
    return (folder / _CHECKPOINT).exists()


def read_checkpoint(
    folder: Path, network: nn.Module, optimizer: torch.optim.Optimizer
) -> Checkpoint:
    """Restore network and optimizer from a folder; without a checkpoint the run is at step 0.

    Raises:
        ConfigError: If the file is damaged or of another network.
    """
    path = folder / _CHECKPOINT
    if not path.exists():
        return Checkpoint(0, 0.0)
    like = {f"network/{key}": value for key, value in network.state_dict().items()}
    try:
        there = read_tensors(path)
    except ConfigError as error:
        raise ConfigError(f"{error}; remove the file to start at step 0 (--start-from keeps the "
                          "weights), or name another --out") from None
    learned = {name: p for name, p in network.named_parameters() if f"step/{name}" in there}
    like |= {f"{key}/{name}": torch.zeros(()) if key == "step" else p
             for name, p in learned.items() for key in _moments(optimizer)}
    like["at"] = torch.zeros(2, dtype=torch.float64)
    found = read_weights(path, like, "this training")
    step, seconds = found["at"].tolist()
    if step < 0 or step != int(step):
        raise ConfigError(f"{path}: step {step} is not a number of steps")
    if step and not learned:
        raise ConfigError(f"{path}: no state of this optimizer; start in another folder")
    network.load_state_dict({k[8:]: v for k, v in found.items() if k.startswith("network/")})
    for name, parameter in learned.items():
        optimizer.state[parameter] = {
            key: found[f"{key}/{name}"].to("cpu" if key == "step" else parameter.device)
            for key in _moments(optimizer)
        }
    return Checkpoint(int(step), seconds)
