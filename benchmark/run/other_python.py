"""A method in another Python, which need not have gcbench: `gcbench eval --python PYTHON`.

    worker process of gcbench (method_worker.py) <-- pipes --> PYTHON (methods/standalone.py)

The worker hands over observations and reads answers as a typed JSON header and raw arrays, both of
bounded size; nothing that the method sends is unpickled. If PYTHON ends, the worker ends in the
same way, so that time limits, memory limits and messages are those of any method.
"""

from __future__ import annotations

import inspect
import math
import os
import re
import select
import subprocess
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import SimpleNamespace
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...errors import MethodError
from ...renderer.runtime import end_like, parse_json, to_record
from ...renderer.types import Observation
from ..methods import method_source, options_of, standalone

_HELLO = "gcbench-method "
_START = (
    "import sys; sys.path[:1] == [''] and sys.path.pop(0); "
    f"sys.stdout.write('{_HELLO}%d.%d.%d\\n' % sys.version_info[:3]); sys.stdout.flush(); "
    "exec(sys.argv[1]); serve_tasks()"
)
"""Files in the current folder hide no module; the version also comes from a Python that is too old
for the rest."""
_OLDEST = (3, 8)
_MOST_LINES = 50
"""Lines that a script may print before it runs Python, such as those of `module load`."""
_NOT_PASSED = ("PYTHONPATH", "PYTHONHOME", "PWD", "OLDPWD")
"""Environment variables that belong to this Python, or name the current folder."""
_MAX_HEADER, _MAX_ARRAYS = 2**20, 2**28  # bytes
_TYPE = re.compile(r"\|[bui]1|<[iuf][248]")
_Size = Annotated[int, msgspec.Meta(ge=0)]
_Seconds = Annotated[float, msgspec.Meta(ge=0)]


@dataclass(frozen=True)
class _Ready:
    """The first answer."""

    problem: str = ""
    declared: Mapping[str, Any] = msgspec.field(default_factory=dict)
    can_estimate: bool = False
    """Whether it has a function `estimate`."""
    options: tuple[str, ...] = ()
    """Those of the offered options that it takes."""
    versions: Mapping[str, str] = msgspec.field(default_factory=dict)


@dataclass(frozen=True)
class _Answer:
    status: Literal["ok", "raised", "invalid"]
    reason: str
    seconds: _Seconds | None
    peak_memory: _Seconds | None
    arrays: tuple[tuple[str, str, tuple[_Size, ...]], ...]


class OtherPython:
    """A method in a process of another Python. It has the attributes of the method."""

    def __init__(self, python: str, source: str, threads: int) -> None:
        """Start the process and load the method `source`, with those options that it takes.

        Raises:
            MethodError: If the interpreter or the method cannot be used.
        """
        self._name = f"{method_source(source.partition('?')[0])} in {python}"
        environment = {k: v for k, v in os.environ.items() if k not in _NOT_PASSED}
        program = inspect.getsource(standalone)
        try:
            self._process = subprocess.Popen(
                [python, "-c", _START, program], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                env=environment)
        except OSError as error:
            raise MethodError(f"--python {python}: {error.strerror}") from error
        self._check_version(python)
        offered = options_of(source)
        self._send({"source": method_source(source.partition("?")[0]), "options": offered,
                    "threads": threads}, {})
        ready = to_record(self._receive(), _Ready, self._name, error=MethodError)
        if ready.problem:
            raise MethodError(f"--python {python}: {ready.problem}")
        self.options = {key: offered[key] for key in ready.options if key in offered}
        self.versions = ready.versions
        for name in standalone.DECLARED:
            if name in ready.declared:
                setattr(self, name, ready.declared[name])
        self.estimate = self.attempt if ready.can_estimate else None
        if isinstance(levels := ready.declared.get("knowledge"), list) and "model" in levels:
            self.knowledge = [level for level in levels if level != "model"]
            if not self.knowledge:
                raise MethodError(f"{self._name} needs the articulated model, which only a method "
                                  "in the Python of gcbench can get; leave out --python")

    def attempt(self, observation: Observation) -> standalone.Attempt:
        """Run the method, whatever it raises."""
        values = {field.name: getattr(observation, field.name) for field in fields(observation)}
        arrays = {k: v for k, v in values.items() if isinstance(v, np.ndarray)}
        began = time.monotonic()
        self._send({k: v for k, v in values.items() if k not in arrays}, arrays)
        answer = to_record(self._receive(), _Answer, self._name, error=MethodError)
        found = self._read_arrays(answer)
        seconds = answer.seconds and min(answer.seconds, time.monotonic() - began)
        value = SimpleNamespace(**dict.fromkeys(standalone.RETURNED) | found)
        return standalone.Attempt(answer.status, answer.reason, seconds, answer.peak_memory, value)

    def _check_version(self, python: str) -> None:
        """Read the line with which every Python begins, after lines of a script that runs it."""
        version, said, first = None, "", ""
        for _ in range(_MOST_LINES):
            said = self._read_line(may_end=bool(first))
            version = re.fullmatch(_HELLO + r"(\d{1,3})\.(\d{1,3})\.\d{1,3}", said)
            if version is not None or not said:
                break
            first = first or said
        if version is None:
            raise MethodError(f"--python {python}: not a Python interpreter; it said {first!a}")
        if (int(version[1]), int(version[2])) < _OLDEST:
            raise MethodError(f"--python {python}: Python {said[len(_HELLO):]} is too old; methods "
                              f"need {_OLDEST[0]}.{_OLDEST[1]} or newer")

    def _send(self, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        assert self._process.stdin is not None
        try:
            standalone.write_message(self._process.stdin, header, arrays)
        except BrokenPipeError:
            end_like(self._process.wait())

    def _receive(self) -> dict[str, Any]:
        size = int.from_bytes(self._read(4), "big")
        if size > _MAX_HEADER:
            raise MethodError(f"{self._name}: it sent no answer, but {size} bytes")
        return parse_json(bytes(self._read(size)), f"{self._name}: its answer", error=MethodError)

    def _read_arrays(self, answer: _Answer) -> dict[str, NDArray[Any]]:
        found: dict[str, NDArray[Any]] = {}
        left = _MAX_ARRAYS
        for name, dtype, shape in answer.arrays:
            if name not in standalone.RETURNED or not _TYPE.fullmatch(dtype) or len(shape) > 3:
                raise MethodError(f"{self._name}: its answer has an array {name[:40]!a} of "
                                  f"{len(shape)} dimensions and type {dtype[:40]!a}")
            size = math.prod(shape) * np.dtype(dtype).itemsize
            left -= size
            if left < 0:
                raise MethodError(f"{self._name}: it returned more than {_MAX_ARRAYS} bytes")
            found[name] = np.frombuffer(self._read(size), dtype).reshape(shape)
        return found

    def _read_line(self, may_end: bool) -> str:
        """Read a line that is not empty; if the process `may_end`, return "" where it has."""
        line = b""
        while not line.strip() or not line.endswith(b"\n"):
            piece = self._read(1, may_end)
            line += piece
            if not piece or len(line) > 200:
                break
        return line.decode(errors="replace").strip()

    def _read(self, size: int, may_end: bool = False) -> bytearray:
        """Read from the process, or end as it did; a copy of it may keep its pipe open.

        If it `may_end`, return what there is.
        """
        assert self._process.stdout is not None
        pipe, out = self._process.stdout.fileno(), bytearray()
        while len(out) < size:
            ended = self._process.poll() is not None
            if select.select([pipe], [], [], 0 if ended else 0.2)[0]:
                piece = os.read(pipe, min(size - len(out), 2**20))
                if not piece and not may_end:
                    end_like(self._process.wait())
                if not piece:
                    break
                out += piece
            elif ended and may_end:
                break
            elif ended:
                end_like(self._process.wait())
        return out
