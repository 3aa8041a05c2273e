"""The networks that `gcbench train` knows."""

# pyright: basic
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...errors import ConfigError
from .abbatematteo_task import AbbatematteoTask
from .config import (
    AbbatematteoTraining,
    CravesTraining,
    DustNetTraining,
    FlowTraining,
    ForegroundTraining,
    PeopleTraining,
    ScrewNetTraining,
    TrainConfig,
)
from .craves_task import CravesTask
from .dustnet_task import DustNetTask
from .flow_task import FlowTask
from .foreground_task import ForegroundTask
from .loop import train
from .people_task import PeopleTask
from .screwnet_task import ScrewNetTask
from .task import Scores, TrainingTask

_WEIGHTS = Path(__file__).parents[1] / "weights"
_TASKS: dict[type[TrainConfig], type[TrainingTask]] = {
    FlowTraining: FlowTask, ForegroundTraining: ForegroundTask, PeopleTraining: PeopleTask,
    ScrewNetTraining: ScrewNetTask, AbbatematteoTraining: AbbatematteoTask,
    DustNetTraining: DustNetTask, CravesTraining: CravesTask,
}


def task_of(config: TrainConfig) -> TrainingTask:
    """Return the task of a network's options.

    Raises:
        ConfigError: If there is no network with such options, or there are no such weights to
            start from.
    """
    kind = type(config)
    if kind not in _TASKS:
        raise ConfigError(f"{kind.__name__} are options of no network")
    task = _TASKS[kind](config)
    start = config.start_from
    if start is None or start.suffix or start.exists():
        return task
    return replace(task, config=replace(config, start_from=_find_start(str(start), task.name)))


def _find_start(weights: str, network: str) -> Path:
    """Return the file of weights that come with gcbench by their name."""
    files = {file.stem.removeprefix(f"{network}-"): file
             for pattern in (f"{network}-*", network)
             for file in _WEIGHTS.glob(f"{pattern}.safetensors")}
    if weights not in files:
        raise ConfigError(f"no file and no weights of gcbench: {weights}; --start-from takes a "
                          f"file, or one of {', '.join(sorted(files))}")
    return files[weights]


def run_training(config: TrainConfig) -> str:
    """Train a network; return the errors on the held-out data as text, and where the files are."""
    task = task_of(config)
    tables = [f"{path}: {task.unit}\n{scores_table(scores)}"
              for path, scores in train(task).items()]
    return "\n".join([*tables, str(config.out)])


def scores_table(scores: Scores) -> str:
    """Return a line of text for each name below a header of metrics; - where one is not defined."""
    metrics = list(dict.fromkeys(metric for row in scores.values() for metric in row))
    lines = [f"  {'':12}" + "".join(f" {metric:>12}" for metric in metrics)]
    for name, row in scores.items():
        values = [f"{row[m]:12.4g}" if m in row else f"{'-':>12}" for m in metrics]
        lines.append(f"  {name:12} " + " ".join(values))
    return "\n".join(lines)
