"""Datasets that networks learn from, rendered here from objects of no suite."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...renderer.dataset import open_dataset, read_meta, sequence_paths
from ...renderer.generate import render_dataset
from ...renderer.runtime import address, exists, list_folder, plural, say
from ...renderer.scene import (
    CameraConfig,
    ImageConfig,
    LightsConfig,
    MotionConfig,
    RandomizationConfig,
    RenderConfig,
    TexturesConfig,
)
from ...renderer.types import Meta
from ...robots.appliances import CATEGORIES
from ...robots.catalog import load_robot
from .config import RecipeConfig, TrainConfig

_FEW = 12  # datasets
_READERS = 8  # sequences that are read at a time


@dataclass(frozen=True)
class PlannedDataset:
    """One dataset of a recipe."""

    name: str
    config: RenderConfig
    sequences: int
    held_out: bool = False


def plan_datasets(
    models: int, seed: int, robots: tuple[str, ...] = (), recipe: RecipeConfig | None = None
) -> Iterator[PlannedDataset]:
    """Yield `models` datasets of the stream "train", most of them without textures.

    Every second dataset is of one of the `robots`, if there are any. The others are of random
    objects, and of appliances, which differ in each sequence. Images have half of the benchmark's
    resolution (crops are also enlarged); parts turn by up to 14 deg a frame, more than twice the
    benchmark's.
    """
    recipe = recipe or RecipeConfig()
    for number in range(models):
        rng = np.random.default_rng([seed, number])
        own = 10_000 * seed + number
        turn, place = divmod(number, recipe.appliance_every)
        if robots and number % 2 == 0:
            robot = robots[number // 2 % len(robots)]
        elif place == recipe.appliance_every - 1:
            robot = CATEGORIES[turn % len(CATEGORIES)]
        else:
            robot = f"random:{own}"
        joints = () if robot in CATEGORIES else _draw_joints(
            load_robot(robot).joint_names, recipe.max_joints, rng)
        config = _draw_config(robot, joints, own, recipe, rng)
        name = f"{Path(robot.partition(':')[0]).stem}-{own}"
        yield PlannedDataset(name, config, recipe.sequences)


def _draw_joints(names: tuple[str, ...], most: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Two to `most` of the names, in order; one where there is only one."""
    count = int(rng.integers(min(2, len(names)), min(len(names), most) + 1))
    return tuple(names[j] for j in sorted(rng.choice(len(names), count, replace=False)))


def _draw_config(
    robot: str, joints: tuple[str, ...], seed: int, recipe: RecipeConfig,
    rng: np.random.Generator,
) -> RenderConfig:
    slow = rng.random() < recipe.slow_probability
    step = float(rng.uniform(*(recipe.slow if slow else recipe.fast)))
    fill = float(rng.uniform(*recipe.fill))
    textured = rng.random() < recipe.texture_probability
    texture = float(rng.uniform(*recipe.texture)) if textured else 0.0
    return RenderConfig(
        robot=robot,
        seed=seed,
        twin_of="",  # as the included weights; seeds differ
        stream="train",
        frames=recipe.frames,
        width=recipe.width,
        height=recipe.height,
        scored_joints=joints,
        keep_unobservable=True,
        randomization=RandomizationConfig(
            motion=MotionConfig(total=(2.0, 0.8 * step * (recipe.frames - 1)), max_step=step),
            camera=CameraConfig(fill=(fill, min(1.4 * fill, 0.95))),
            lights=LightsConfig(number=(1, 4), ambient=(0.1, 0.5)),
            textures=TexturesConfig(probability=texture),
            image=ImageConfig(noise=(0.0, 2.0), blur=(0.0, 0.4), exposure=(-0.5, 0.5)),
        ),
    )


def render_datasets(
    out: Path, planned: Iterable[PlannedDataset], config: TrainConfig
) -> tuple[list[Path], list[Path]]:
    """Render datasets to folders in `out`; those that are there are kept.

    Of few datasets, each shows its own progress: it may take many minutes.

    Returns the folders to learn from, and those to measure errors on.

    Raises:
        RenderError: If this machine cannot render.
    """
    from tqdm import tqdm

    folders: tuple[list[Path], list[Path]] = [], []
    datasets = list(planned)
    few = len(datasets) <= _FEW
    for dataset in tqdm(datasets, "render", unit="dataset", dynamic_ncols=True, disable=few):
        folder = out / dataset.name
        render_dataset(dataset.config, dataset.sequences, folder, config.workers, progress=few)
        folders[dataset.held_out].append(folder)
    return folders


def find_datasets(paths: tuple[Path, ...]) -> list[Path]:
    """Return the paths that are datasets, and the datasets in the other folders.

    Raises:
        DatasetError: If there is no dataset at a path, or one has no sequences.
    """
    out: list[Path] = []
    for path in paths:
        found = [p for p in [path] if exists(p / "dataset.json")] or [
            p for p in list_folder(path) if exists(p / "dataset.json")]
        if not found:
            raise DatasetError(f"{address(path)}: there is no dataset; render one with "
                               "`gcbench render`")
        if empty := [p for p in found if not sequence_paths(p)]:
            raise DatasetError(f"{address(empty[0])} has no sequences; render some, or leave it "
                               "out")
        out += found
    return out


def refuse_test_streams(paths: list[Path]) -> None:
    """Check that no dataset is of the stream that suites score on.

    Raises:
        DatasetError: If one is.
    """
    for path in paths:
        if open_dataset(path).config.stream != "train":
            raise DatasetError(
                f"{address(path)} is of the stream `test`, which suites score on; render training "
                "data with --stream train"
            )


def check_sequences(folders: list[Path], describe_misfit: Callable[[Meta], str]) -> None:
    """Check that each sequence opens and fits a network; `describe_misfit` says why one does not.

    Raises:
        DatasetError: If a sequence does not; it names the file.
    """
    for folder in folders:
        paths = sequence_paths(folder)
        with ThreadPoolExecutor(_READERS) as pool:
            for path, meta in zip(paths.values(), pool.map(read_meta, paths.values()), strict=True):
                if problem := describe_misfit(meta):
                    raise DatasetError(f"{address(path)} {problem}")


def warn_of_leaks(held_out: list[Path], data: list[Path]) -> None:
    """Say which held-out datasets have sequences that are learned from, at whatever path."""
    learned_from = set[_SequenceId]().union(*map(_sequence_ids, data))
    for path in held_out:
        ids = _sequence_ids(path)
        if shared := len(ids & learned_from):
            which = f", {shared} of {plural(len(ids), 'sequence')}," * (shared < len(ids))
            say(f"{address(path)}{which} is also learned from: its errors are not those of new "
                "data")


_SequenceId = tuple[str, str, int, str]


def _sequence_ids(path: Path) -> set[_SequenceId]:
    """Return what tells the sequences of a dataset from those of others."""
    dataset = open_dataset(path)
    c = dataset.config
    return {(c.robot, c.stream, c.seed, name) for name in dataset.names}


def draw_place(seed: int, number: int, count: int) -> tuple[np.random.Generator, int]:
    """Return the generator of sample `number`, and its place in 0 .. count - 1.

    Each epoch has every place once, in another order.
    """
    epoch, turn = divmod(number, count)
    return np.random.default_rng([seed, number]), int(_shuffle(seed, epoch, count)[turn])


@lru_cache(maxsize=2)
def _shuffle(seed: int, epoch: int, count: int) -> NDArray[np.int64]:
    return np.random.default_rng([seed, epoch, count]).permutation(count)
