"""What a method reads of a file of weights that `gcbench train` wrote."""

# pyright: basic
from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, MethodError
from ...renderer.types import Observation
from ..networks.torch_runtime import Tensor, find_device, nn, torch
from ..networks.weights import read_notes, read_tensors, read_weights

TRAINED = Path(__file__).parents[1] / "weights"
"""Folder of the weights that come with gcbench: METHOD-NAME.safetensors."""


@dataclass(frozen=True)
class Trained:
    """A trained network on its device."""

    network: nn.Module
    device: torch.device
    objects: str
    """What it has learned from, such as "dishwasher, oven"."""
    label: str
    """The same with the width, for the name of a row; `net=` and a hash of the tensors tell
    networks apart that do not come with gcbench."""
    features: str = ""
    """Name of the network whose features it began with; empty if it began at random."""

    def describe_training(self, seen: str) -> str:
        """Return what a method says of its training; `seen` is such as "depth video"."""
        begun = f", begun with features of {self.features}" if self.features else ""
        return f"supervised: {seen} of {self.objects}{begun}"

    def tensor(self, array: NDArray[np.float32]) -> Tensor:
        """Return an array as a tensor on the device."""
        return torch.from_numpy(array).to(self.device)


def load_trained(
    name: str, weights: str, device: str,
    width_of: Callable[[Mapping[str, Tensor]], int],
    make: Callable[[int, Mapping[str, Tensor]], nn.Module],
    published: int = 64,
) -> Trained:
    """Load the network `name` of any width: from the file that `gcbench train` wrote, or by the
    name of weights that come with gcbench.

    `width_of` returns the width of the network that has some tensors, or 0, and `make` returns a
    network of a width and of their sizes. `published` is the width in the paper, the largest.

    Raises:
        ConfigError: If there are no such weights, or they are not of this network.
    """
    recipe = f"gcbench train {name} --out {name}, then --weights {name}/{name}.safetensors"
    path = find_weights(name, weights, recipe)
    tensors = read_tensors(path)
    width = width_of(tensors)
    if not 8 <= width <= published:
        raise ConfigError(f"{path}: no weights of {name}; make them with {recipe}")
    network = make(width, tensors).eval()
    network.load_state_dict(read_weights(path, network.state_dict(), name))
    network.to(find_device(device))
    notes = read_notes(path)
    objects = notes.get("objects", "unknown objects")[:100]
    label = objects.replace(", ", "+") + (f" width={width}" if width < published else "")
    if path.resolve().parent != TRAINED.resolve():
        label += f" net={_hash_tensors(tensors)[:8]}"
    return Trained(network, find_device(device), objects, label, notes.get("features", "")[:100])


def _hash_tensors(tensors: Mapping[str, Tensor]) -> str:
    digest = hashlib.sha256()
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {list(tensor.shape)}\n".encode())
        digest.update(tensor.contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def find_weights(method: str, weights: str, recipe: str) -> Path:
    """Return the file of weights that come with gcbench by their name, or the file itself.

    Raises:
        ConfigError: If there is none; it lists the names.
    """
    files = TRAINED.glob(f"{method}-*.safetensors")
    shipped = {file.stem[len(method) + 1 :]: file for file in files}
    path = shipped.get(weights, Path(weights))
    if weights and path.is_file():
        return path
    missing = f"no file and no weights of gcbench: {weights}; " if weights else ""
    names = f"--weights {' or '.join(sorted(shipped))}, or your own: " if shipped else ""
    raise ConfigError(f"{missing}{method} needs weights: {names}{recipe}")


def depth_of_one_joint(observation: Observation, name: str) -> NDArray[np.float32]:
    """Return the depth images [T H W] m.

    Raises:
        MethodError: If there is no depth, or not one joint.
    """
    if observation.depth is None:
        raise MethodError(f"{name} needs depth: --inputs rgbd")
    if observation.n_joints != 1:
        raise MethodError(f"{name} sees one joint; this object has {observation.n_joints}")
    return observation.depth
