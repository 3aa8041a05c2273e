"""The commands `gcbench train`."""

from collections.abc import Sequence


def train_flow(args: Sequence[str]) -> tuple[object, int]:
    """Train the optical flow network of GC-Pose."""
    return _train("flow", args)


def train_screwnet(args: Sequence[str]) -> tuple[object, int]:
    """Train ScrewNet, a baseline: one joint from depth video."""
    return _train("screwnet", args)


def train_abbatematteo(args: Sequence[str]) -> tuple[object, int]:
    """Train Abbatematteo et al., a baseline: one joint from a depth image."""
    return _train("abbatematteo", args)


def _train(name: str, args: Sequence[str]) -> tuple[object, int]:
    from ..renderer.runtime import command_line
    from .training.config import CONFIGS

    config = CONFIGS[name]
    options = command_line.parse_options(args, f"train {name}", config, config.__doc__)
    from .training.tasks import run_training

    return run_training(options), 0
