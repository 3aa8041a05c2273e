"""The commands `gcbench train`."""

from collections.abc import Sequence
from pathlib import Path


def train_flow(args: Sequence[str]) -> tuple[object, int]:
    """Train the optical flow network of GC-Pose."""
    return _train("flow", args)


def train_foreground(args: Sequence[str]) -> tuple[object, int]:
    """Train the network of GC-Pose that finds what moves in a plain video."""
    return _train("foreground", args)


def train_screwnet(args: Sequence[str]) -> tuple[object, int]:
    """Train ScrewNet, a baseline: one joint from depth video."""
    return _train("screwnet", args)


def train_abbatematteo(args: Sequence[str]) -> tuple[object, int]:
    """Train Abbatematteo et al., a baseline: one joint from a depth image."""
    return _train("abbatematteo", args)


def train_dustnet(args: Sequence[str]) -> tuple[object, int]:
    """Train DUST-net, a baseline: a distribution of one joint's motion from depth video."""
    return _train("dustnet", args)


def train_craves(args: Sequence[str]) -> tuple[object, int]:
    """Train CRAVES, a baseline: keypoints of the OWI-535 in an image."""
    return _train("craves", args)


def craves_images(
    path: Path, /, weights: str, device: str = "auto", limit: int = 0
) -> tuple[object, int]:
    """Score CRAVES on single images: of its Lab data, or of a dataset of the OWI-535.

    The errors are those of absolute angles, in all images and in the better half of them, which is
    what CRAVES publishes.

    Examples:
      gcbench craves-images ~/craves/test_20181024 --weights craves/craves.safetensors
      gcbench craves-images data/owi535 --weights craves/craves.safetensors --limit 100

    Args:
        path: Folder of the Lab data (angles/, joint/, FusionCameraActor3_2/), or of a dataset.
        weights: File of `gcbench train craves`.
        device: `cpu`, `cuda`, ...; `auto`: a GPU if there is one.
        limit: Score the first images only; 0: all.
    """
    from .learned.craves_images import score_images

    return score_images(path, weights, device, limit).table(), 0


def _train(name: str, args: Sequence[str]) -> tuple[object, int]:
    from ..renderer.runtime import command_line
    from .training.config import CONFIGS

    config = CONFIGS[name]
    options = command_line.parse_options(args, f"train {name}", config, config.__doc__)
    from .training.tasks import run_training

    return run_training(options), 0
