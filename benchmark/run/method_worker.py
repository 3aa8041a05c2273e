"""The worker process of a method: receives tasks, passes observations, returns estimates.

Messages are bytes, so no output of a method is unpickled. A task is JSON. An answer is one letter
and its content: READY a declaration (JSON), STARTED nothing, DONE the ZIP of an estimate, PROBLEM
text. The process isolates failures; it is not a sandbox for malicious code.
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
    """One sequence to estimate for one row."""

    data: str
    """Folder of the dataset."""
    sequence: str
    inputs: str
    knowledge: str
    oracles: tuple[str, ...] = ()


def serve(connection: Connection, source: str, threads: int) -> None:
    """Load the method and process tasks until the connection closes: the process's target."""
    try:
        _serve(connection, source, threads)
    except GcbenchError as error:
        connection.send_bytes(PROBLEM + str(error).encode())
    except BrokenPipeError:
        pass  # the parent process has ended
    except BaseException:
        connection.send_bytes(PROBLEM + f"{source}: {traceback.format_exc()}".encode())


def _serve(connection: Connection, source: str, threads: int) -> None:
    import cv2

    cv2.setNumThreads(threads)
    from ..methods import declaration_of, load_method

    method = load_method(source)
    connection.send_bytes(READY + json.dumps(asdict(declaration_of(method, source))).encode())
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
    """Run the method and return its estimate or its failure as a storable record."""
    from ..protocol import observe, shape_of
    from ..results import InvalidEstimateError, Stored, validate_estimate

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
        return Stored("ok", "", seconds, peak_memory(), validate_estimate(value, shape))
    except InvalidEstimateError as error:
        return Stored("invalid", str(error), seconds, peak_memory())


def load_model(dataset: Dataset, sequence: str) -> ArticulatedModel:
    """Return the articulated model of a sequence of a dataset."""
    from ...renderer.scene import model_of

    return model_of(dataset.config, dataset[sequence].meta, download=True)


def _model(
    dataset: Dataset, task: Task, models: dict[tuple[str, str], ArticulatedModel]
) -> ArticulatedModel:
    """Return the model of a sequence, cached in `models`; only categories have several models."""
    from ...robots.catalog import is_category

    key = task.data, task.sequence if is_category(dataset.config.robot) else ""
    if key not in models:
        models.clear()
        models[key] = load_model(dataset, task.sequence)
    return models[key]


def peak_memory() -> float | None:
    """Return the peak memory since `_forget_peak`, MiB; None if the system does not report it."""
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
