"""What a flow network learns from, rendered here: objects that no suite holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...renderer.generate import generate
from ...renderer.scene import (
    CameraConfig,
    ImageConfig,
    LightsConfig,
    MotionConfig,
    RandomizationConfig,
    RenderConfig,
    TexturesConfig,
)
from ...robots.appliances import CATEGORIES
from ...robots.catalog import load_robot

_FRAMES = 9
_SEQUENCES = 4
"""Of each model: many models teach more than many views of one."""
_MOST_JOINTS = 6
_TEXTURED = 0.25
_APPLIANCES = 8
"""One dataset in so many."""


@dataclass(frozen=True)
class Shoot:
    """One dataset of a recipe."""

    name: str
    config: RenderConfig
    sequences: int


def recipe(models: int, seed: int, robots: tuple[str, ...] = ()) -> Iterator[Shoot]:
    """`models` datasets of the stream "train", plain for the most part: random objects, and
    appliances, another one in each sequence. Every other one is of the `robots`, if there are any.

    At half of the benchmark's resolution (crops are enlarged, too); motions of up to 14 deg a step,
    more than twice the benchmark's.
    """
    for number in range(models):
        rng = np.random.default_rng([seed, number])
        own = 10_000 * seed + number
        if robots and number % 2 == 0:
            robot = robots[number // 2 % len(robots)]
        elif number % _APPLIANCES == _APPLIANCES - 1:
            robot = CATEGORIES[number // _APPLIANCES % len(CATEGORIES)]
        else:
            robot = f"random:{own}"
        joints = () if robot in CATEGORIES else _some(load_robot(robot).joint_names, rng)
        config = _config(robot, joints, own, rng)
        yield Shoot(f"{Path(robot.partition(':')[0]).stem}-{own}", config, _SEQUENCES)


def _some(names: tuple[str, ...], rng: np.random.Generator) -> tuple[str, ...]:
    """Two to six of them, in order; one where there is but one."""
    count = int(rng.integers(min(2, len(names)), min(len(names), _MOST_JOINTS) + 1))
    return tuple(names[j] for j in sorted(rng.choice(len(names), count, replace=False)))


def _config(
    robot: str, joints: tuple[str, ...], seed: int, rng: np.random.Generator
) -> RenderConfig:
    step = float(rng.uniform(2.0, 7.0) if rng.random() < 0.7 else rng.uniform(7.0, 14.0))
    fill = float(rng.uniform(0.35, 0.8))
    textured = float(rng.uniform(0.3, 1.0)) if rng.random() < _TEXTURED else 0.0
    return RenderConfig(
        robot=robot,
        seed=seed,
        stream="train",
        frames=_FRAMES,
        width=320,
        height=240,
        scored_joints=joints,
        keep_unobservable=True,
        randomization=RandomizationConfig(
            motion=MotionConfig(total=(2.0, 0.8 * step * (_FRAMES - 1)), max_step=step),
            camera=CameraConfig(fill=(fill, min(1.4 * fill, 0.95))),
            lights=LightsConfig(number=(1, 4), ambient=(0.1, 0.5)),
            textures=TexturesConfig(probability=textured),
            image=ImageConfig(noise=(0.0, 2.0), blur=(0.0, 0.4), exposure=(-0.5, 0.5)),
        ),
    )


def rendered(
    out: Path, models: int, seed: int, workers: int | None = None, robots: tuple[str, ...] = ()
) -> list[Path]:
    """Folders of the recipe's datasets in `out`; those that are there are not rendered again.

    Raises GcbenchError where nothing renders.
    """
    from tqdm import tqdm

    folders: list[Path] = []
    shoots = recipe(models, seed, robots)
    for shoot in tqdm(shoots, "render", models, unit="model", dynamic_ncols=True):
        folder = out / shoot.name
        generate(shoot.config, shoot.sequences, folder, workers, progress=False)
        folders.append(folder)
    return folders
