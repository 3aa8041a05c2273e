"""The process that a method runs in: receives tasks, hands over observations, returns estimates.

Messages are bytes, so that nothing that a method made is ever unpickled: a task is JSON; an answer
is one letter and its content (READY a declaration, STARTED nothing, DONE an estimate's ZIP, PROBLEM
text). This keeps accidents away from the run; it is no sandbox against malice.
"""

from __future__ import annotations

import json
import time
import traceback
from contextlib import suppress
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import GcbenchError
from ...renderer.runtime import receive_tasks

if TYPE_CHECKING:
    from ...renderer.dataset import Dataset
    from ...renderer.types import Method
    from ...robots.model import ArticulatedModel
    from ..results import EstimateShape, Stored

READY, STARTED, DONE, PROBLEM = b"R", b"S", b"D", b"P"


@dataclass(frozen=True)
class Task:
    """One sequence for one row."""

    data: str
    """Folder of the dataset."""
    sequence: str
    inputs: str
    knowledge: str
    oracles: tuple[str, ...] = ()


def serve(connection: Connection, source: str, threads: int) -> None:
    """Load the method, and estimate until the connection ends. The target of the process."""
    try:
        _serve(connection, source, threads)
    except GcbenchError as error:
        connection.send_bytes(PROBLEM + str(error).encode())
    except BrokenPipeError:
        pass  # the parent is gone
    except BaseException:
        connection.send_bytes(PROBLEM + f"{source}: {traceback.format_exc()}".encode())


def _serve(connection: Connection, source: str, threads: int) -> None:
    import cv2

    cv2.setNumThreads(threads)
    from ..methods import declare, load

    method = load(source)
    connection.send_bytes(READY + json.dumps(asdict(declare(method, source))).encode())
    opened: dict[str, Dataset] = {}
    models: dict[tuple[str, str], ArticulatedModel] = {}
    for data in receive_tasks(connection, Connection.recv_bytes):
        task = Task(**json.loads(data))
        if task.data not in opened:
            from ...renderer.dataset import open_dataset

            opened[task.data] = open_dataset(Path(task.data))
        dataset = opened[task.data]
        model = _model(dataset, task, models) if task.knowledge == "model" else None
        stored = _attempt(method, task, dataset, model, connection)
        from ..results import dump_stored

        connection.send_bytes(DONE + dump_stored(stored))


def _attempt(
    method: Method,
    task: Task,
    dataset: Dataset,
    model: ArticulatedModel | None,
    connection: Connection,
) -> Stored:
    """Whatever the method does, something that can be stored (unless the process dies)."""
    from ..protocol import observe, shape_of
    from ..results import InvalidEstimateError, Stored, checked

    sequence = dataset[task.sequence]
    observation = observe(sequence, task.inputs, task.knowledge, task.oracles, model)  # pyright: ignore[reportArgumentType]
    shape: EstimateShape = shape_of(sequence)
    connection.send_bytes(STARTED)
    _forget_peak()
    started = time.perf_counter()
    try:
        value = method.estimate(observation)
    except BaseException as error:
        last = traceback.format_exc(limit=-6)
        return Stored("raised", f"{type(error).__name__}: {_text(error)}\n{last}")
    seconds = time.perf_counter() - started
    try:
        return Stored("ok", "", seconds, peak_memory(), checked(value, shape))
    except InvalidEstimateError as error:
        return Stored("invalid", str(error), seconds, peak_memory())


def load_model(dataset: Dataset, sequence: str) -> ArticulatedModel:
    """The articulated model that a sequence of a dataset shows."""
    from ...renderer.scene import model_of

    return model_of(dataset.config, dataset[sequence].meta, download=True)


def _model(
    dataset: Dataset, task: Task, models: dict[tuple[str, str], ArticulatedModel]
) -> ArticulatedModel:
    """`load_model`, once a dataset unless its sequences differ; `models` has the last one."""
    from ...robots.catalog import is_category

    key = task.data, task.sequence if is_category(dataset.config.robot) else ""
    if key not in models:
        models.clear()
        models[key] = load_model(dataset, task.sequence)
    return models[key]


def peak_memory() -> float | None:
    """MiB that this process held at most since `_forget_peak`; None where nobody says."""
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    return None


def _forget_peak() -> None:
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _text(error: BaseException) -> str:
    try:
        return str(error)
    except Exception:
        return "(its message cannot be printed)"
