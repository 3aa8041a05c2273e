"""The worker process of a method: receives observations, returns estimates.

It has neither the dataset nor its path. An answer is one letter and its content: READY a
declaration (JSON), STARTED nothing, DONE the ZIP of an estimate, PROBLEM text; no output of a
method is unpickled. The process isolates failures; it is not a sandbox for malicious code.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from ...errors import GcbenchError
from ...renderer.runtime import receive_tasks

if TYPE_CHECKING:
    from ...renderer.types import Observation
    from ..methods import Declaration, standalone
    from ..results import EstimateShape, Stored

READY, STARTED, DONE, PROBLEM = b"R", b"S", b"D", b"P"


def serve(connection: Connection, source: str, threads: int, python: str) -> None:
    """Load the method and estimate until the connection closes: the process's target."""
    try:
        _serve(connection, source, threads, python)
    except GcbenchError as error:
        connection.send_bytes(PROBLEM + _encode(str(error)))
    except BrokenPipeError:
        pass  # the parent process has ended
    except BaseException as error:
        from ..methods import standalone

        connection.send_bytes(PROBLEM + _encode(f"{source}: {standalone.describe_error(error)}"))


def _serve(connection: Connection, source: str, threads: int, python: str) -> None:
    from ..results import dump_stored
    from .handover import receive_observation

    declared, estimate = _load(source, threads, python)
    declaration = json.dumps(asdict(declared))
    for name in ("PWD", "OLDPWD"):
        os.environ.pop(name, None)
    os.chdir(tempfile.gettempdir())  # an empty folder, which the pool removes
    connection.send_bytes(READY + declaration.encode())
    for observation, shape in receive_tasks(connection, receive_observation):
        connection.send_bytes(STARTED)
        answer = dump_stored(_attempt(estimate, observation, shape))
        del observation  # before the answer: its memory is then free for the next
        connection.send_bytes(DONE + answer)


def _load(
    source: str, threads: int, python: str
) -> tuple[Declaration, Callable[[Observation], standalone.Attempt]]:
    """Return the declaration of a method, and what runs it, here or in another Python."""
    import cv2

    from ..methods import declaration_of, open_method, standalone, with_options
    from .other_python import OtherPython

    cv2.setNumThreads(threads)
    if python:
        other = OtherPython(python, source, threads)
        taken = with_options(source.partition("?")[0], other.options)
        declared = declaration_of(other, taken)
        return replace(declared, source=taken, versions=other.versions), other.attempt
    taken, method = open_method(source)
    return replace(declaration_of(method, taken), source=taken), partial(standalone.attempt, method)


def _attempt(
    estimate: Callable[[Observation], standalone.Attempt], observation: Observation,
    shape: EstimateShape,
) -> Stored:
    """Run the method and return its estimate or its failure as a storable record."""
    from ..methods import standalone
    from ..results import InvalidEstimateError, Stored, validate_estimate

    status, reason, seconds, memory, value = estimate(observation)
    if status == "raised":
        return Stored("raised", reason)
    if status == "ok":
        try:
            return Stored("ok", "", seconds, memory, validate_estimate(value, shape))
        except InvalidEstimateError as error:
            reason = str(error)
        except BaseException as error:
            reason = f"reading what it returned raised {standalone.name_error(error)}"
    return Stored("invalid", reason, seconds, memory)


def _encode(text: str) -> bytes:
    return text.encode(errors="backslashreplace")
