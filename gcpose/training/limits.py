"""The ranges of the options of `gcbench train`."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from math import inf
from typing import Any

from ...errors import ConfigError
from .config import CravesTraining, ObjectTraining, TrainConfig

_SHARE, _LESS_THAN_ALL, _FACTOR = (0.0, 1.0), (0.0, 0.99), (0.1, 10.0)
_ABOVE_0 = 1e-9
_LIMITS: dict[str, tuple[float, float]] = {
    "batch": (1, inf), "rate": (0, inf), "weight_decay": (0, inf),
    "max_gradient": (_ABOVE_0, inf), "seed": (0, inf), "workers": (0, inf), "threads": (0, inf),
    "every": (1, inf), "minutes": (0, inf), "warm_up": (0, 0.99), "first_rate": _SHARE,
    "crop": (48, inf), "iterations": (1, 100), "models": (1, inf), "held_out_pairs": (1, inf),
    "frames": (2, inf), "appliances": (1, inf), "held_out_sequences": (1, inf),
    "epochs": (1, inf), "width": (8, inf), "sequences": (1, inf), "dropped": _LESS_THAN_ALL,
    "rate_decay": _SHARE, "freeze_features": _SHARE, "feature_views": (0, 100),
    "dropout": _LESS_THAN_ALL, "gate_gain": (_ABOVE_0, 1000), "images": (1, inf),
    "held_out_images": (1, inf), "rotation": (0, 180), "color": _FACTOR, "scale": _FACTOR,
    "gain": _FACTOR, "gamma": _FACTOR, "noise": (0, 255),
    "loss.speed_discount": (0, inf), "loss.decay": _SHARE,
    "views.turn": (0, 30), "views.scale": _FACTOR, "views.mirror": _SHARE,
    "augmentation.resize": _FACTOR, "augmentation.gamma": _FACTOR, "augmentation.offset": (-1, 1),
    "augmentation.gain": _FACTOR, "augmentation.channel_gain": _FACTOR,
    "augmentation.exposure": _FACTOR, "augmentation.noise": (0, 255),
    "augmentation.blur": (0.01, 100), "recipe.sequences": (1, inf), "recipe.frames": (2, inf),
    "recipe.width": (48, inf), "recipe.height": (48, inf), "recipe.max_joints": (1, inf),
    "recipe.appliance_every": (1, inf), "recipe.slow": (0.01, 180), "recipe.fast": (0.01, 180),
    "recipe.fill": (0.01, 0.95), "recipe.texture": _SHARE,
}
"""The least and the largest value of each option; those that are not here have _SHARE if they are
a probability, and otherwise 0 or more."""


def check_numbers(config: TrainConfig) -> None:
    """Raise ConfigError if a number is out of range, or the larger end of a range is first."""
    steps = -1 if isinstance(config, ObjectTraining | CravesTraining) else 0
    if config.steps < steps:
        raise ConfigError(f"--steps {config.steps}: give {steps} or more")
    _check_tree(config, "")


def _check_tree(options: Any, group: str) -> None:
    for option in fields(options):
        name, value = group + option.name, getattr(options, option.name)
        if is_dataclass(value):
            _check_tree(value, f"{name}.")
        elif name != "steps" and isinstance(value, int | float | tuple):
            numbers = value if isinstance(value, tuple) else (value,)
            if all(isinstance(x, int | float) for x in numbers):
                _check_range(name, numbers)


def _check_range(name: str, numbers: tuple[float, ...]) -> None:
    probability = _SHARE if name.endswith("probability") else (0.0, inf)
    least, most = _LIMITS.get(name, probability)
    option = f"--{name.replace('_', '-')} {' '.join(f'{x:g}' for x in numbers)}"
    if not all(least <= x <= most and x < inf for x in numbers):
        between = f"from {least:g} to {most:g}" if most < inf else f"of {least:g} or more"
        if least == _ABOVE_0:
            between = "above 0" + f", at most {most:g}" * (most < inf)
        raise ConfigError(f"{option}: give a number {between}")
    if name != "crop" and list(numbers) != sorted(numbers):
        raise ConfigError(f"{option}: give the smaller number first")
