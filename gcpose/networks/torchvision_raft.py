"""RAFT (Teed and Deng, ECCV 2020) of torchvision, which is not a dependency of gcbench."""

# pyright: basic
from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from ...errors import ConfigError, MethodError, suggestion
from .torch_runtime import nn, torch
from .weights import read_weights

TORCHVISION_MULTIPLE, TORCHVISION_MIN_SIDE = 8, 128
"""Sides of the images must be multiples of the first and at least the second, px."""
_DATA = {"C": "FlyingChairs", "T": "FlyingThings3D", "S": "Sintel", "K": "KITTI", "H": "HD1K"}
_OPERATORS = ("nms", "qnms")


def import_torchvision() -> Any:
    """Import torchvision, also where it is built for another PyTorch than the installed one.

    Then its compiled operators do not load, and its import fails because two of them are not
    declared. Neither optical flow nor the preparation of images uses them.

    Raises:
        MethodError: If it is missing.
    """
    try:
        try:
            return import_module("torchvision")
        except RuntimeError:
            for name in _OPERATORS:
                torch.library.define(f"torchvision::{name}", "() -> Tensor")
            return import_module("torchvision")
    except (ImportError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise MethodError(
            f"--flow torchvision:NAME needs torchvision ({reason}): pip install torchvision"
        ) from error


def load_torchvision_raft(name: str, weights: str = "") -> tuple[nn.Module, str]:
    """Load a network, and weights by their name in torchvision or from a file.

    Default: torchvision's default weights. torchvision downloads them into its cache.

    Returns:
        The network on the CPU; it takes images [B 3 H W] in -1..1 and returns flows [B 2 H W] px,
        the best one last. And what it was trained on.

    Raises:
        ConfigError: If a name is unknown, or the weights cannot be read or downloaded.
        MethodError: If torchvision is missing.
    """
    models = import_torchvision().models
    known = models.list_models(module=models.optical_flow)
    if name not in known:
        raise ConfigError(f"torchvision has no optical flow {name!r}{suggestion(name, known)}; "
                          f"there are {', '.join(known)}")
    network, offered = models.get_model(name, weights=None), models.get_model_weights(name)
    if weights and weights not in offered.__members__:
        if not Path(weights).is_file():
            raise ConfigError(
                f"torchvision:{name} has no weights {weights!r}"
                f"{suggestion(weights, offered.__members__)}, and there is no such file; there are "
                f"{', '.join(offered.__members__)}")
        network.load_state_dict(read_weights(Path(weights), network.state_dict(), name))
        return network, f"unknown: the file {Path(weights).name}"
    chosen = offered[weights] if weights else offered.DEFAULT
    try:
        network.load_state_dict(chosen.get_state_dict(
            progress=False, check_hash=True, map_location="cpu", weights_only=True))
    except Exception as error:  # no network, no space, a damaged file
        reason = (str(error) or type(error).__name__).splitlines()[0][:120]
        raise ConfigError(
            f"torchvision cannot load {chosen.url} ({reason}); download it elsewhere and use "
            f"--flow torchvision:{name}:FILE") from error
    data = dict.fromkeys(_DATA[letter] for letter in "".join(chosen.name.split("_")[:-1]))
    return network, (f"supervised: {', '.join(data)} (torchvision {name} {chosen.name}; licence "
                     "not stated: terms of these datasets)")
