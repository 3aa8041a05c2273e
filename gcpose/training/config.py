"""Options of `gcbench train flow`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class LossConfig:
    """Weights of the loss."""

    bias: float = 1.0  # Weight of the mean error over each part.
    coarse: float = 0.7  # Weight of the iterations' coarse flows.
    decay: float = 0.8  # Weight of an iteration against the next.
    correlation: float = 0.3
    """Weight of the correlations at the beginning; it falls to 0 at half of the training."""
    moving: float = 0.8  # Weight of all moving parts together, against what is static.
    hidden: float = 0.2  # Weight of a pixel that the other image does not show.
    speed_discount: float = 0.05  # Reduction of a pixel's weight by its motion, 1/px.


@dataclass(frozen=True)
class AugmentationConfig:
    """Random changes of samples; pairs are ranges."""

    resize_probability: float = 0.5
    resize: tuple[float, float] = (0.75, 1.6)  # Factor of the image's size.
    mirror_probability: float = 0.5  # Of each axis.
    gamma: tuple[float, float] = (0.7, 1.4)
    offset: tuple[float, float] = (-0.1, 0.1)  # Brightness that is added, of 1.
    gain_probability: float = 0.7
    gain: tuple[float, float] = (0.7, 1.2)
    channel_gain: tuple[float, float] = (0.85, 1.15)  # Further gain of each channel.
    exposure_probability: float = 0.25
    exposure: tuple[float, float] = (0.97, 1.03)  # Gain of the second image against the first.
    noise_probability: float = 0.4
    noise: tuple[float, float] = (0.0, 4.0)  # Standard deviation, grey levels.
    blur_probability: float = 0.2
    blur: tuple[float, float] = (0.3, 0.9)  # Standard deviation, px.


@dataclass(frozen=True)
class RecipeConfig:
    """Datasets that are rendered if none are given; pairs are ranges."""

    sequences: int = 4  # Sequences of each model: many models teach more than many views of one.
    frames: int = 9
    width: int = 320
    height: int = 240
    max_joints: int = 6
    appliance_every: int = 8  # One dataset in this number shows appliances.
    slow_probability: float = 0.7
    slow: tuple[float, float] = (2.0, 7.0)  # Largest turn in a frame, deg.
    fast: tuple[float, float] = (7.0, 14.0)  # The same in the other datasets, deg.
    fill: tuple[float, float] = (0.35, 0.8)
    """Share of the image's side that the model fills at least."""
    texture_probability: float = 0.25
    texture: tuple[float, float] = (0.3, 1.0)
    """Probability that a surface has a texture, in datasets with textures."""


@dataclass(frozen=True)
class TrainConfig:
    """Options of a training run."""

    data: tuple[Path, ...] = ()
    """Datasets (`gcbench render --stream train`), or folders of them; default: random objects
    and appliances, rendered into OUT/data first."""
    out: Path = Path("raft")
    """Folder of the weights (raft.safetensors), the checkpoint and the log (log.jsonl); a run
    that was stopped continues from there."""
    start_from: Path | None = None
    """Weights with which a new run begins (a run in OUT continues from its own); default: random
    weights."""
    held_out: tuple[Path, ...] = ()  # Datasets on which the errors are measured, against DIS.
    steps: int = 60_000  # 0 measures the errors without training.
    batch: int = 4  # Samples in a step.
    rate: float = 8e-4  # Highest learning rate of the cycle.
    warm_up: float = 0.05  # Share of the steps in which the rate rises.
    first_rate: float = 0.04  # Rate of the first step, as a share of the highest.
    weight_decay: float = 1e-4
    max_gradient: float = 1.0  # Norm to which gradients are clipped.
    crop: tuple[int, int] = (176, 144)
    """Width and height of the crops that are learned from, px; multiples of 16."""
    iterations: int = 4
    """Corrections that the network makes in training (6 in use, 3 when tuned to a video)."""
    models: int = 300  # Objects to render if no data are given.
    robots: tuple[str, ...] = ()
    """Robots (names or files) that half of them are; the others are random."""
    seed: int = 1
    device: str = "auto"  # `cpu`, `cuda`, ...; `auto`: a GPU if there is one.
    precision: Literal["bfloat16", "float32"] = "bfloat16"
    """Of the arithmetic in training; weights are float32."""
    workers: int = 0
    """Processes that prepare samples (a GPU needs 8 and more) and that render; 0: samples in the
    training process, and one renderer for each core."""
    threads: int = 0  # Of the arithmetic on a CPU; default: all cores.
    every: int = 1000  # Steps between two checks on the held-out data.
    held_out_pairs: int = 40  # Pairs of each held-out dataset in a check.
    minutes: float = 3.0  # Time between two checkpoints.
    loss: LossConfig = field(default_factory=LossConfig)
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    recipe: RecipeConfig = field(default_factory=RecipeConfig)
