"""What runs beside a method: load it, call it, and hand over what it returned.

The process of a method imports this module. In another Python (`gcbench eval --python`) the text
of the module runs by itself, after `PYTHON -c`; so it needs Python 3.8 and NumPy alone.

A message is 4 bytes with the length of a header, the header (JSON), and the bytes of the arrays
that the header lists under `arrays` as [name, dtype, shape].
"""

from __future__ import annotations

import faulthandler
import importlib
import importlib.util
import inspect
import json
import os
import platform
import queue
import sys
import tempfile
import threading
import time
import traceback
import types
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple

DECLARED = ("name", "version", "training", "inputs", "knowledge", "hint", "authors", "link", "date")
"""Attributes of a method that another process sends; the last four are optional."""
RETURNED = ("displacement", "screw", "part", "sigma", "reliable")
"""Attributes of an estimate."""


class CannotLoadError(Exception):
    """A method cannot be loaded; the text says why."""


class Attempt(NamedTuple):
    """One call of a method."""

    status: str
    """ok or raised"""
    reason: str = ""
    """The exception, with the last calls."""
    seconds: float | None = None
    peak_memory: float | None = None
    """MiB; None if the system does not report it."""
    value: Any = None
    """What it returned."""


def find_method(source: str) -> Any:
    """Import module:attribute or FILE.py:attribute and return the attribute.

    Modules are also searched in the current folder. Raises CannotLoadError if there is none.
    """
    where, _, attribute = source.rpartition(":")
    module = _import_file(where) if where.endswith(".py") else _import_module(where, source)
    found: Any = module
    for part in attribute.split("."):
        if not hasattr(found, part):
            names = ", ".join(n for n in vars(module) if not n.startswith("_"))
            raise CannotLoadError(f"{source}: {where} has no {part!r}; it has {names}")
        found = getattr(found, part)
    return found


def parameters_of(method: Any) -> dict[str, Any]:
    """Return the defaults of what the constructor of a method takes, by name; of an object: none.
    """
    if not callable(method) or not (isinstance(method, type) or not hasattr(method, "estimate")):
        return {}
    try:
        return {p.name: p.default for p in inspect.signature(method).parameters.values()}
    except ValueError:
        return {}


def attempt(method: Any, observation: Any) -> Attempt:
    """Run a method on an observation, whatever it raises."""
    _forget_peak()
    started = time.perf_counter()
    try:
        value = method.estimate(observation)
    except BaseException as error:
        return Attempt("raised", describe_error(error))
    return Attempt("ok", "", time.perf_counter() - started, peak_memory(), value)


def peak_memory() -> float | None:
    """Return the peak memory since the last attempt began, MiB; None if it is not known."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(x.split()[1]) for x in lines if x.startswith("VmHWM:")) / 1024.0
    except (OSError, ValueError, StopIteration):
        return None


def _forget_peak() -> None:
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def describe_error(error: BaseException) -> str:
    """Return the type and message of the exception that is handled, and the last calls."""
    return f"{name_error(error)}\n{traceback.format_exc(limit=-6)}"


def name_error(error: BaseException) -> str:
    """Return the type and message of an exception, which may raise anything."""
    try:
        return f"{type(error).__name__}: {error}"
    except BaseException:
        return f"{type(error).__name__} (its message cannot be printed)"


def write_message(stream: IO[bytes], header: dict[str, Any], arrays: dict[str, Any]) -> None:
    """Write a header, and arrays by name. Raises OSError."""
    listed = [[name, array.dtype.str, array.shape] for name, array in arrays.items()]
    head = json.dumps({**header, "arrays": listed}).encode()
    stream.write(len(head).to_bytes(4, "big") + head)
    for array in arrays.values():
        stream.write(array.tobytes())
    stream.flush()


def _import_module(name: str, source: str) -> types.ModuleType:
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # last, so that files here hide no installed package
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and (name == error.name or name.startswith(error.name + ".")):
            raise CannotLoadError(f"{source}: no module {error.name!r}") from error
        raise CannotLoadError(f"{source} needs the package {error.name!r}; install it") from error


def _import_file(name: str) -> types.ModuleType:
    path = Path(name).expanduser().resolve()
    if not path.is_file():
        raise CannotLoadError(f"{path}: no such file")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise CannotLoadError(f"{path}: not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault(path.stem, module)  # dataclasses need it
    sys.path.append(str(path.parent))
    spec.loader.exec_module(module)
    return module


# -- in another Python ------------------------------------------------------------------------


class _Observation(types.SimpleNamespace):
    """The fields of `gcbench.Observation`."""

    @property
    def parents(self) -> Any:
        import numpy as np

        return np.array(self.joint_parent or range(-1, self.n_joints - 1), np.int64)


class _Estimate(types.SimpleNamespace):
    """The fields of `gcbench.Estimate`."""

    def __init__(self, displacement: Any, screw: Any = None, part: Any = None, sigma: Any = None,
                 reliable: Any = None) -> None:
        super().__init__(displacement=displacement, screw=screw, part=part, sigma=sigma,
                         reliable=reliable)


def serve_tasks() -> None:
    """Load the method that the first message names, and estimate until stdin ends."""
    tasks, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what the method prints is no answer
    faulthandler.enable()
    sys.argv = sys.argv[:1]
    inbox: queue.Queue[Any] = queue.Queue()
    threading.Thread(target=_read_tasks, args=(tasks, inbox), daemon=True).start()
    order, _ = inbox.get()
    method = None
    try:
        method, ready = _load(order)
        os.chdir(tempfile.gettempdir())
        header = json.loads(json.dumps(ready, default=repr))
    except CannotLoadError as error:
        header = {"problem": _plain(str(error))}
    except BaseException as error:
        header = {"problem": _plain(f"{order['source']}: {describe_error(error)}")}
    write_message(answers, header, {})
    while True:  # until `_read_tasks` ends the process
        fields, arrays = inbox.get()
        done = attempt(method, _Observation(**fields, **arrays))
        header, found = done._asdict(), {}
        value = header.pop("value")
        try:
            found = _arrays_of(value) if done.status == "ok" else {}
        except _InvalidError as error:
            header.update(status="invalid", reason=str(error))
        except BaseException as error:
            reason = f"reading what it returned raised {name_error(error)}"
            header.update(status="invalid", reason=reason)
        write_message(answers, {**header, "reason": _plain(header["reason"])}, found)


def _load(order: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the method, and what is declared of it."""
    try:
        import numpy as np
    except ImportError as error:
        raise CannotLoadError("there is no NumPy; install it there") from error
    if importlib.util.find_spec("gcbench") is None:
        _offer_types()
    method = find_method(order["source"])
    taken = [name for name in order["options"] if name in parameters_of(method)]
    if isinstance(method, type) or not hasattr(method, "estimate"):
        if not callable(method):
            raise CannotLoadError(f"{order['source']}: not a method")
        method = method(**{name: order["options"][name] for name in taken})
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(order["threads"])
    declared = {key: getattr(method, key) for key in DECLARED if hasattr(method, key)}
    versions = {"python": platform.python_version(), "numpy": np.__version__}
    can_estimate = callable(getattr(method, "estimate", None))
    return method, {"declared": declared, "can_estimate": can_estimate, "options": taken,
                    "versions": versions}


def _offer_types() -> None:
    """Let methods `import gcbench` for the two types that they need, where it is not installed."""
    module = types.ModuleType("gcbench", "Observation and Estimate alone: gcbench is not here.")
    module.Observation, module.Estimate = _Observation, _Estimate  # type: ignore[attr-defined]
    sys.modules["gcbench"] = module


def _read_tasks(tasks: IO[bytes], inbox: queue.Queue[Any]) -> None:
    """Queue every message; end the process when there is no more, also while a method runs."""
    while True:
        size = tasks.read(4)
        if len(size) < 4:
            os._exit(0)
        header = json.loads(tasks.read(int.from_bytes(size, "big")))
        arrays = {}
        for name, dtype, shape in header.pop("arrays"):
            import numpy as np

            array = np.empty(shape, dtype)
            tasks.readinto(array.reshape(-1).view(np.uint8))  # type: ignore[attr-defined]
            arrays[name] = array
        inbox.put((header, arrays))


class _InvalidError(Exception):
    """What a method returned cannot be sent; the text says why."""


def _arrays_of(value: Any) -> dict[str, Any]:
    import numpy as np

    if not hasattr(value, "displacement"):
        raise _InvalidError(f"returned {type(value).__name__}, expected gcbench.Estimate")
    given = {name: getattr(value, name, None) for name in RETURNED}
    found: dict[str, Any] = {}
    for name, field in given.items():
        if field is not None:
            try:
                array = np.asarray(field)
            except Exception as error:  # a foreign class may raise anything
                raise _InvalidError(f"{name} is not an array ({name_error(error)})") from error
            if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
                raise _InvalidError(
                    f"{name} is {array.dtype} {list(array.shape)}, expected numbers")
            found[name] = array
    return found


def _plain(text: str) -> str:
    """Return the end of a text, as UTF-8 can express it."""
    return text[-4000:].encode(errors="backslashreplace").decode()
