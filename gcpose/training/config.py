"""Options of `gcbench train`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg


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

    resize_probability: float = 0.5  # Share of the pairs that are resized.
    resize: tuple[float, float] = (0.75, 1.6)  # Factor of the image's size.
    mirror_probability: float = 0.5  # Share of the pairs that are mirrored, for each axis.
    gamma: tuple[float, float] = (0.7, 1.4)  # Exponent of the brightness.
    offset: tuple[float, float] = (-0.1, 0.1)  # Brightness that is added, in units of white.
    gain_probability: float = 0.7  # Share of the pairs with a gain.
    gain: tuple[float, float] = (0.7, 1.2)  # Gain of all channels.
    channel_gain: tuple[float, float] = (0.85, 1.15)  # Further gain of each channel.
    exposure_probability: float = 0.25  # Share of the pairs whose images differ in exposure.
    exposure: tuple[float, float] = (0.97, 1.03)  # Gain of the second image against the first.
    noise_probability: float = 0.4  # Share of the pairs with noise.
    noise: tuple[float, float] = (0.0, 4.0)  # Standard deviation, grey levels.
    blur_probability: float = 0.2  # Share of the pairs with blur.
    blur: tuple[float, float] = (0.3, 0.9)  # Standard deviation, px.


@dataclass(frozen=True)
class ViewConfig:
    """Other views of the depth videos that a network learns from; they are exact."""

    turn: float = 0.0  # Largest turn of the camera about each of its axes, deg.
    scale: tuple[float, float] = (1.0, 1.0)  # Range of the factor of all lengths.
    mirror: float = 0.0  # Share of the samples that are mirrored.


@dataclass(frozen=True)
class RecipeConfig:
    """Datasets that are rendered if none are given; pairs are ranges."""

    sequences: int = 4  # Sequences of each model: many models teach more than many views of one.
    frames: int = 9  # Frames of a sequence.
    width: int = 320  # Width of the images, px.
    height: int = 240  # Height of the images, px.
    max_joints: int = 6  # Most joints that move.
    appliance_every: int = 8  # Every n-th dataset shows appliances.
    slow_probability: float = 0.7  # Share of the datasets with slow motion.
    slow: tuple[float, float] = (2.0, 7.0)  # Largest turn in a frame, deg.
    fast: tuple[float, float] = (7.0, 14.0)  # The same in the other datasets, deg.
    fill: tuple[float, float] = (0.35, 0.8)
    """Share of the image's side that the model fills at least."""
    texture_probability: float = 0.25  # Share of the datasets with textures.
    texture: tuple[float, float] = (0.3, 1.0)
    """Probability that a surface has a texture, in datasets with textures."""


@dataclass(frozen=True)
class TrainConfig:
    """Options of every training run."""

    data: tuple[Path, ...] = ()
    """Datasets (`gcbench render --stream train`), or folders of them; default: the command renders
    them into OUT/data first."""
    out: Path = Path("trained")
    """Folder of the weights, the checkpoint, the log (log.jsonl) and its curves (curves.html); a
    run that was stopped continues from there. Its --steps and --held-out may change, and how it is
    computed (--workers, --threads, --device); with other data or options it is refused."""
    start_from: Path | None = None
    """Weights with which a new run begins (a run in OUT continues from its own): a file, or the
    name of weights of this network that come with gcbench, such as microwave; default: random
    weights."""
    held_out: tuple[Path, ...] = ()  # Datasets on which the errors are measured.
    steps: int = 10_000  # 0 measures the errors without training.
    batch: int = 4  # Samples in a step.
    rate: float = 1e-3  # Highest learning rate.
    weight_decay: float = 1e-4  # Factor of the weights that the optimizer subtracts.
    max_gradient: float = 1.0  # Norm to which gradients are clipped.
    seed: int = 1  # Seed of the initial weights, the samples and the rendered data.
    device: str = "auto"  # `cpu`, `cuda`, ...; `auto`: a GPU if there is one.
    workers: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Processes that prepare samples (a GPU needs 8 and more) and that render; 0: one for each
    core. Default: samples in the training process, and one renderer for each core."""
    threads: int = 0  # Threads of the arithmetic on a CPU; default: all cores.
    precision: Literal["auto", "bfloat16", "float32"] = "auto"
    """Precision of the arithmetic in training; weights are float32. auto: bfloat16 on a GPU or CPU
    with instructions for it; on other CPUs, bfloat16 takes ten times as long as float32."""
    half: bool = False  # Write the file of weights in half precision (the checkpoint is not).
    every: int = 1000  # Steps between two checks on the held-out data.
    minutes: float = 3.0  # Time between two checkpoints.


@dataclass(frozen=True)
class FlowTraining(TrainConfig):
    """Train the optical flow network of GC-Pose.

    To continue an interrupted run, run the same command again. Without --data, the command renders
    its training data: random articulated and rigid objects that no suite contains, and appliances
    of the stream "train". It uses a GPU if there is one.

    Examples:
      gcbench train flow --out raft --held-out data/ur5-train
      gcbench train flow --out raft --robots panda.urdf kinova.urdf --steps 100000 --workers 8
      gcbench train flow --data data/train --out raft --start-from gcpose/weights/raft.safetensors
    """

    out: Path = Path("raft")
    steps: int = 60_000  # 0 measures the errors without training.
    rate: float = 8e-4  # Highest learning rate.
    warm_up: float = 0.05  # Share of the steps in which the rate rises.
    first_rate: float = 0.04  # Rate of the first step, as a share of the highest.
    crop: tuple[int, int] = (176, 144)
    """Width and height of the crops that are learned from, px; multiples of 16."""
    iterations: int = 4
    """Corrections that the network makes in training (6 in use, 3 when tuned to a video)."""
    models: int = 300  # Objects to render if no data are given.
    robots: tuple[str, ...] = ()
    """Robots (names or files) for half of the objects; the others are random."""
    held_out_pairs: int = 40  # Pairs of each held-out dataset in a check.
    loss: LossConfig = field(default_factory=LossConfig)
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    recipe: RecipeConfig = field(default_factory=RecipeConfig)


@dataclass(frozen=True)
class ForegroundTraining(TrainConfig):
    """Train the network of GC-Pose that finds what moves in a plain video.

    To continue an interrupted run, run the same command again. Without --data, the command renders
    appliances and random objects of the stream "train", and others to measure the errors on.

    Examples:
      gcbench train foreground --out foreground
      gcbench train foreground --data data/train --held-out data/held --out mask --steps 4000
      gcbench eval --method gcpose --inputs rgb --foreground network:mask/foreground.safetensors
    """

    out: Path = Path("foreground")
    steps: int = 5000  # 0 measures the errors without training.
    batch: int = 3  # Videos in a step.
    rate: float = 2e-3  # Highest learning rate; it rises first and then falls to 0.
    frames: int = 8  # Successive frames that are learned from together.
    appliances: int = 250  # Sequences of each class of appliances, if no data are given.
    models: int = 60  # Random objects, of 4 sequences each, if no data are given.
    held_out_sequences: int = 12  # Further ones of each class, for the checks.
    scale: tuple[float, float] = (0.85, 1.35)  # Range of the factor of the square's side.
    noise: tuple[float, float] = (0.0, 2.0)  # Range of its standard deviation, grey levels.
    noise_probability: float = 0.4  # Share of the videos with noise.
    gain: tuple[float, float] = (0.7, 1.25)  # Range of the gain of each color channel.
    gamma: tuple[float, float] = (0.75, 1.35)  # Range of the exponent of the brightness.


@dataclass(frozen=True)
class PeopleTraining(ForegroundTraining):
    """Train the network of GC-Pose that finds people, who are left out of a plain video.

    To continue an interrupted run, run the same command again. Without --data, the command renders
    appliances and random objects of the stream "train". People are drawn over them: someone moves
    the object.

    Examples:
      gcbench train people --out people
      gcbench train people --data data/train --held-out data/held --out people --steps 4000
      gcbench eval --method gcpose --inputs rgb --foreground no-people:people/people.safetensors
    """

    out: Path = Path("people")
    people_probability: float = 0.7  # Share of the videos with a person.


@dataclass(frozen=True)
class ObjectTraining(TrainConfig):
    """Options of the networks that learn from objects with one joint."""

    epochs: int = 100  # Times that each sequence is seen.
    steps: int = -1  # Default: as many as the epochs have; 0 measures the errors only.
    width: int = 64  # Channels of the first layers, a multiple of 8; all other sizes follow.
    classes: tuple[str, ...] = ("microwave",)
    """Classes of objects to render if no data are given; each sequence shows another object."""
    sequences: int = 4000  # Of all classes together.
    held_out_sequences: int = 100  # Further ones, for the checks.
    frames: int = 16  # Of a sequence.
    dropped: float = 0.1  # Share of the pixels that are set to zero in training.
    rate_decay: float = 0.0
    """Share of the steps, at the end, in which the learning rate falls to 0 (cosine); 0: the rates
    of the network's authors."""
    views: ViewConfig = field(default_factory=ViewConfig)


@dataclass(frozen=True)
class ScrewNetTraining(ObjectTraining):
    """Train ScrewNet, a baseline: the screw motion of one joint from depth video.

    To continue an interrupted run, run the same command again. Without --data, the command renders
    appliances of the stream "train", and others to measure the errors on. It uses a GPU if there
    is one; a small --width trains on a CPU. The defaults are those of the paper.

    Examples:
      gcbench train screwnet --out screwnet --classes microwave
      gcbench train screwnet --out across --classes dishwasher oven --width 16 --sequences 1000
      gcbench eval --method screwnet --weights screwnet/screwnet.safetensors --data data/microwave
    """

    out: Path = Path("screwnet")
    batch: int = 40  # Samples in a step.
    weight_decay: float = 1e-2  # Adam adds it, times the weights, to the gradient.
    max_gradient: float = 10.0  # Norm to which gradients are clipped.
    freeze_features: float = 0.0
    """Share of the steps, at the beginning, in which the features of an image stay as they are in
    --start-from."""
    feature_views: int = 0
    """Samples of each sequence whose features are computed once, before the first step; steps then
    cost little. It needs --freeze-features 1. 0: each step computes features of new samples."""


@dataclass(frozen=True)
class AbbatematteoTraining(ObjectTraining):
    """Train the network of Abbatematteo et al., a baseline: a joint's angle in one depth image.

    To continue an interrupted run, run the same command again. Without --data, the command renders
    appliances of the stream "train", and others to measure the errors on. It uses a GPU if there
    is one; a small --width trains on a CPU, with a higher --rate than that of the authors' code.

    Examples:
      gcbench train abbatematteo --out joint --classes microwave
      gcbench train abbatematteo --out small --width 16 --sequences 1000 --rate 0.001 --epochs 30
      gcbench eval --method abbatematteo --weights joint/abbatematteo.safetensors --data DIR
    """

    out: Path = Path("abbatematteo")
    batch: int = 128  # Images in a step.
    rate: float = 1e-5  # Highest learning rate.
    weight_decay: float = 1e-5  # Adam adds it, times the weights, to the gradient.
    max_gradient: float = 10.0  # Norm to which gradients are clipped.
    dropout: float = 0.5  # Share of the image's features that are left out in training.
    gate_gain: float = 1.0
    """Factor of the gradient of the mixture's weights, so that it learns to choose a component."""


@dataclass(frozen=True)
class CravesTraining(TrainConfig):
    """Train the network of CRAVES, a baseline: 17 keypoints of the OWI-535 in one image.

    To continue an interrupted run, run the same command again. Without --data, the command renders
    images of the arm, of the stream "train", and others to measure the errors on. It uses a GPU if
    there is one; a small --width trains on a CPU. The defaults are those of the paper.

    Examples:
      gcbench train craves --out craves
      gcbench train craves --out small --width 64 --images 2000 --batch 8 --rate 0.001
      gcbench eval --method craves --weights craves/craves.safetensors --data data/owi535
    """

    out: Path = Path("craves")
    epochs: int = 30  # Times that each image is seen.
    steps: int = -1  # Default: as many as the epochs have; 0 measures the errors only.
    width: int = 256  # Channels of the hourglasses, a multiple of 16; other sizes follow.
    images: int = 5000  # Images to render if no data are given.
    held_out_images: int = 100  # Further ones, for the checks.
    batch: int = 6  # Images in a step.
    rate: float = 2.5e-4  # Learning rate; a tenth of it in the last third of the steps.
    weight_decay: float = 0.0  # The optimizer adds it, times the weights, to the gradient.
    max_gradient: float = 10.0  # Norm to which gradients are clipped.
    scale: tuple[float, float] = (0.6, 1.8)  # Range of the factor of a crop's side.
    rotation: float = 15.0  # Largest turn of a crop, deg.
    color: tuple[float, float] = (0.3, 1.3)  # Range of the gain of each color channel.


@dataclass(frozen=True)
class DustNetTraining(ScrewNetTraining):
    """Train DUST-net, a baseline: a distribution of the motion of one joint from depth video.

    To continue an interrupted run, run the same command again. Without --data, the command renders
    appliances of the stream "train", and others to measure the errors on. It uses a GPU if there
    is one; a small --width trains on a CPU. The defaults are those of the authors' code, with Adam
    in place of stochastic gradient descent.

    Examples:
      gcbench train dustnet --out dustnet --classes microwave
      gcbench train dustnet --out small --classes oven --width 16 --sequences 1000
      gcbench eval --method dustnet --weights dustnet/dustnet.safetensors --data data/microwave
    """

    out: Path = Path("dustnet")
    max_gradient: float = 25.0  # Norm to which gradients are clipped.


CONFIGS: dict[str, type[TrainConfig]] = {
    "flow": FlowTraining, "foreground": ForegroundTraining, "people": PeopleTraining,
    "screwnet": ScrewNetTraining, "abbatematteo": AbbatematteoTraining,
    "dustnet": DustNetTraining, "craves": CravesTraining,
}
"""Options by the name of the network."""
