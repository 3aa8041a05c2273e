"""The networks that `gcbench train` knows."""

# pyright: basic
from __future__ import annotations

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

_TASKS: dict[type[TrainConfig], type[TrainingTask]] = {
    FlowTraining: FlowTask, ForegroundTraining: ForegroundTask, PeopleTraining: PeopleTask,
    ScrewNetTraining: ScrewNetTask, AbbatematteoTraining: AbbatematteoTask,
    DustNetTraining: DustNetTask, CravesTraining: CravesTask,
}


def task_of(config: TrainConfig) -> TrainingTask:
    """Return the task of a network's options."""
    kind = type(config)
    if kind not in _TASKS:
        raise ConfigError(f"{kind.__name__} are options of no network")
    return _TASKS[kind](config)


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
