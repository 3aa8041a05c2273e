"""A training run on disk: network and optimiser as tensors, never as programs."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...errors import GcbenchError
from ...robots.files import replace_atomically
from ..networks.torch_runtime import torch
from ..networks.weights import read_weights

_FILE = "checkpoint.safetensors"
_STATE = ("exp_avg", "exp_avg_sq")


@dataclass(frozen=True)
class Checkpoint:
    """How far a run is."""

    step: int
    seconds: float
    """Of training so far."""


def write_checkpoint(
    folder: Path, network: torch.nn.Module, optimizer: torch.optim.Optimizer, at: Checkpoint
) -> None:
    """Everything that AdamW needs to go on, and the network alone (raft.safetensors), for use."""
    tensors = {f"network/{key}": value for key, value in network.state_dict().items()}
    for name, parameter in network.named_parameters():
        state = optimizer.state[parameter]
        tensors |= {f"{key}/{name}": state[key] for key in _STATE if key in state}
    tensors["at"] = torch.tensor([at.step, at.seconds], dtype=torch.float64)
    _save(folder / _FILE, tensors)
    write_weights(folder / "raft.safetensors", network)


def read_checkpoint(
    folder: Path, network: torch.nn.Module, optimizer: torch.optim.Optimizer
) -> Checkpoint:
    """Put a run where it was; one that never began is at step 0.

    Raises GcbenchError if the file is damaged or of another network.
    """
    path = folder / _FILE
    if not path.exists():
        return Checkpoint(0, 0.0)
    like = {f"network/{key}": value for key, value in network.state_dict().items()}
    named = dict(network.named_parameters())
    like |= {f"{key}/{name}": p for name, p in named.items() for key in _STATE}
    like["at"] = torch.zeros(2, dtype=torch.float64)
    found = read_weights(path, like, "this training")
    step, seconds = found["at"].tolist()
    if step < 0 or step != int(step):
        raise GcbenchError(f"{path}: step {step} is none")
    network.load_state_dict({k[8:]: v for k, v in found.items() if k.startswith("network/")})
    for name, parameter in named.items():
        optimizer.state[parameter] = {
            "step": torch.tensor(float(step)),
            **{key: found[f"{key}/{name}"].to(parameter.device) for key in _STATE},
        }
    return Checkpoint(int(step), seconds)


def write_weights(path: Path, network: torch.nn.Module) -> None:
    """Whole or not at all."""
    _save(path, dict(network.state_dict()))


def _save(path: Path, tensors: dict[str, torch.Tensor]) -> None:
    from safetensors.torch import save_file

    try:
        with replace_atomically(path) as temporary:
            save_file({k: v.detach().cpu().contiguous() for k, v in tensors.items()}, temporary)
    except OSError as error:
        raise GcbenchError(f"{path}: {error.strerror or error}") from error
