"""The estimates of jobs by one method: made by processes of this machine, or by actors of Ray."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import replace

from ...errors import MethodError
from ...renderer.cluster import ActorWork, RayCluster, run_on_ray
from ...renderer.dataset import Dataset
from ...renderer.scene import model_of
from ...renderer.types import Observation
from ...renderer.types import Sequence as Video
from ...robots.catalog import is_category
from ...robots.model import ArticulatedModel
from ..protocol import Allocate, observe, shape_of
from ..results import EstimateShape, Stored
from .isolation import Limits, run_method
from .jobs import Job
from .schedule import interleave


def estimate(
    source: str, jobs: Sequence[Job], limits: Limits, cluster: RayCluster | None = None
) -> Generator[tuple[Job, str, Stored]]:
    """Make and store what is missing in the jobs of one method, and yield what was stored.

    Close the iterator to stop at once. With a cluster, an estimate stays where it is stored, and
    its record has none.

    Raises:
        MethodError: If the method cannot be loaded.
    """
    tasks = interleave(jobs)
    if cluster is None:
        with closing(run_method(source, deque(tasks), _Observer().observe, limits)) as answers:
            for (job, name), answer in answers:
                yield job, name, job.write(name, answer)
        return
    numbers = {job: k for k, job in enumerate(jobs)}
    work = ActorWork[tuple[int, str]](
        "gcbench.benchmark.run.estimation:MethodRunner", (source, tuple(jobs), limits),
        lambda task: f"{jobs[task[0]].row.title} on {jobs[task[0]].data.name}/{task[1]}",
        MethodError)
    todo = [(numbers[job], name) for job, name in tasks]
    with closing(run_on_ray(work, todo, cluster)) as records:
        for task, stored in records:
            if task is not None:
                yield jobs[task[0]], task[1], stored


class MethodRunner:
    """A process of a method that an actor has beside it."""

    hello = None

    def __init__(self, source: str, jobs: Sequence[Job], limits: Limits, threads: int) -> None:
        self._jobs, self._todo = jobs, deque[tuple[Job, str]]()
        limits = replace(limits, workers=1, threads=threads)
        self._answers = run_method(source, self._todo, _Observer().observe, limits)

    def run(self, task: tuple[int, str]) -> Stored:
        """Store an estimate; return its record without the estimate."""
        self._todo.append((self._jobs[task[0]], task[1]))  # the pool waits for it
        (job, name), answer = next(self._answers)
        return replace(job.write(name, answer), estimate=None)


class _Observer:
    """Reads observations, with the model of a dataset at knowledge `model`."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()
        self._model: ArticulatedModel | None = None

    def observe(
        self, task: tuple[Job, str], allocate: Allocate
    ) -> tuple[Observation, EstimateShape]:
        job, name = task
        row, dataset = job.row, job.data.dataset
        sequence = dataset[name]
        model = self._model_of(dataset, sequence) if row.knowledge == "model" else None
        seen = observe(sequence, row.inputs, row.knowledge, row.oracles, model, allocate)
        return seen, shape_of(sequence)

    def _model_of(self, dataset: Dataset, sequence: Video) -> ArticulatedModel:
        """Return the model of a sequence; only categories have several."""
        several = is_category(dataset.config.robot)
        key = (dataset.path, sequence.meta.name if several else "")
        if self._model is None or key != self._key:
            self._model = model_of(dataset.config, sequence.meta, dataset.allow_model)
            self._key = key
        return self._model
