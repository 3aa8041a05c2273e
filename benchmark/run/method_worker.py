"""The worker process of a method: receives observations, returns estimates.

It has neither the dataset nor its path. An answer is one letter and its content: READY a
declaration (JSON), STARTED nothing, DONE the ZIP of an estimate, PROBLEM text; no output of a
method is unpickled. The process isolates failures; it is not a sandbox for malicious code.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
import traceback
from contextlib import suppress
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import GcbenchError
from ...renderer.runtime import receive_tasks

if TYPE_CHECKING:
    from ...renderer.types import Method, Observation
    from ..results import EstimateShape, Stored

READY, STARTED, DONE, PROBLEM = b"R", b"S", b"D", b"P"


def serve(connection: Connection, source: str, threads: int) -> None:
    """Load the method and estimate until the connection closes: the process's target."""
    try:
        _serve(connection, source, threads)
    except GcbenchError as error:
        connection.send_bytes(PROBLEM + _encode(str(error)))
    except BrokenPipeError:
        pass  # the parent process has ended
    except BaseException as error:
        last = traceback.format_exc(limit=-6)
        connection.send_bytes(PROBLEM + _encode(f"{source}: {_describe(error)}\n{last}"))


def _serve(connection: Connection, source: str, threads: int) -> None:
    import cv2

    cv2.setNumThreads(threads)
    from ..methods import declaration_of, load_method
    from ..results import dump_stored
    from .handover import receive_observation

    method = load_method(source)
    declaration = json.dumps(asdict(declaration_of(method, source)))
    for name in ("PWD", "OLDPWD"):
        os.environ.pop(name, None)
    os.chdir(tempfile.gettempdir())  # an empty folder, which the pool removes
    connection.send_bytes(READY + declaration.encode())
    for observation, shape in receive_tasks(connection, receive_observation):
        connection.send_bytes(STARTED)
        connection.send_bytes(DONE + dump_stored(_attempt(method, observation, shape)))


def _attempt(method: Method, observation: Observation, shape: EstimateShape) -> Stored:
    """Run the method and return its estimate or its failure as a storable record."""
    from ..results import InvalidEstimateError, Stored, validate_estimate

    _forget_peak()
    started = time.perf_counter()
    try:
        value = method.estimate(observation)
    except BaseException as error:
        last = traceback.format_exc(limit=-6)
        return Stored("raised", f"{_describe(error)}\n{last}")
    seconds = time.perf_counter() - started
    try:
        return Stored("ok", "", seconds, peak_memory(), validate_estimate(value, shape))
    except InvalidEstimateError as error:
        return Stored("invalid", str(error), seconds, peak_memory())
    except BaseException as error:
        reason = f"reading what it returned raised {_describe(error)}"
        return Stored("invalid", reason, seconds, peak_memory())


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


def _describe(error: BaseException) -> str:
    try:
        return f"{type(error).__name__}: {error}"
    except BaseException:  # a foreign class may raise anything
        return f"{type(error).__name__} (its message cannot be printed)"


def _encode(text: str) -> bytes:
    return text.encode(errors="backslashreplace")
