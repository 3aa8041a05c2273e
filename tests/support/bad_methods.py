"""Methods that misbehave, by FILE.py:NAME; those in between their accidents are good.

The environment variable CALLS names a file that counts the calls.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import ClassVar

import numpy as np
from gcbench.renderer.types.observation import Estimate, Observation


class Good:
    """Says what it was called with, and moves nothing."""

    name, version, training = "good", "1", "none"
    inputs, knowledge = ("rgbd",), ("axes",)

    def estimate(self, observation: Observation) -> Estimate:
        if counter := os.environ.get("CALLS"):
            with Path(counter).open("a") as file:
                file.write("x")
        return Estimate(np.zeros((len(observation.times), observation.n_joints)))


class Attributed(Good):
    name = "attributed"
    authors, link, date = "A. Author", "https://example.org/@a", "2024-05-01"


class Scripted(Good):
    name = "scripted"
    link = "javascript:alert(1)"


class Reads(Good):
    """Moves by the first pixel, which numbers the sequence; the first ones take longest."""

    name = "reads"

    def estimate(self, observation: Observation) -> Estimate:
        assert observation.rgb is not None
        index = int(observation.rgb[0, 0, 0, 0])
        time.sleep(0.3 / (1 + index))
        estimate = super().estimate(observation)
        estimate.displacement[-1] = 0.1 * (1 + index)
        return estimate


class Keeps(Good):
    """Keeps all that it was given, and finds it changed."""

    name = "keeps"
    kept: ClassVar[list[tuple[Observation, float]]] = []

    def estimate(self, observation: Observation) -> Estimate:
        assert observation.rgb is not None and observation.depth is not None
        self.kept.append((observation, float(observation.rgb.sum() + observation.depth.sum())))
        for other, total in self.kept:
            assert other.rgb is not None and other.depth is not None
            assert other.rgb.sum() + other.depth.sum() == total
        assert len({total for _, total in self.kept}) == len(self.kept)
        return super().estimate(observation)


class _Accident(Good):
    """Something happens to the second sequence."""

    def estimate(self, observation: Observation) -> Estimate:
        path = Path(os.environ["CALLS"])
        calls = len(path.read_text()) if path.exists() else 0
        estimate = super().estimate(observation)
        return self.accident(estimate) if calls == 1 else estimate

    def accident(self, estimate: Estimate) -> Estimate:
        raise NotImplementedError


class Raises(_Accident):
    name = "raises"

    def accident(self, estimate: Estimate) -> Estimate:
        print("my last words")
        raise ZeroDivisionError("of the method")


class Exits(_Accident):
    name = "exits"

    def accident(self, estimate: Estimate) -> Estimate:
        raise SystemExit(3)


class Hangs(_Accident):
    name = "hangs"

    def accident(self, estimate: Estimate) -> Estimate:
        print("going to sleep", flush=True)
        time.sleep(1000)
        return estimate


class Crashes(_Accident):
    name = "crashes"

    def accident(self, estimate: Estimate) -> Estimate:
        os.write(2, b"out of luck\n")
        os._exit(7)


class Nan(_Accident):
    name = "nan"

    def accident(self, estimate: Estimate) -> Estimate:
        estimate.displacement[2, 1] = np.nan
        return estimate


class WrongShape(_Accident):
    name = "wrong-shape"

    def accident(self, estimate: Estimate) -> Estimate:
        return Estimate(estimate.displacement[:, :1])


class Nonsense(_Accident):
    name = "nonsense"

    def accident(self, estimate: Estimate) -> Estimate:
        return "an estimate"  # type: ignore[return-value]


class ReturnsExit(_Accident):
    name = "returns-exit"

    def accident(self, estimate: Estimate) -> Estimate:
        class Trap:
            @property
            def displacement(self) -> None:
                raise SystemExit(0)

        return Trap()  # type: ignore[return-value]


class ReturnsInterrupt(_Accident):
    name = "returns-interrupt"

    def accident(self, estimate: Estimate) -> Estimate:
        class Trap:
            def __array__(self, *_: object, **__: object) -> None:
                raise KeyboardInterrupt

        return Estimate(Trap())  # type: ignore[arg-type]


class RaisesUnprintable(_Accident):
    name = "raises-unprintable"

    def accident(self, estimate: Estimate) -> Estimate:
        class UnprintableError(Exception):
            def __str__(self) -> str:
                raise SystemExit(0)

        raise UnprintableError


class Sabotages(_Accident):
    """Breaks the code of its own process."""

    name = "sabotages"

    def accident(self, estimate: Estimate) -> Estimate:
        sys.modules["gcbench.benchmark.run.method_worker"].__dict__["_attempt"] = None
        return estimate


class ForksAndExits(_Accident):
    """Its copy sleeps, with all files open; CALLS.pid names the copy."""

    name = "forks-and-exits"

    def accident(self, estimate: Estimate) -> Estimate:
        copy = os.fork()
        if copy == 0:
            time.sleep(600)
        Path(os.environ["CALLS"] + ".pid").write_text(str(copy))
        os._exit(0)


class LeavesSession(_Accident):
    """Starts a process in a session of its own and hangs."""

    name = "leaves-session"

    def accident(self, estimate: Estimate) -> Estimate:
        code = "import os, time; os.fork() and os._exit(0); os.setsid(); " \
               "open(os.environ['CALLS'] + '.pid', 'w').write(str(os.getpid())); time.sleep(600)"
        subprocess.run([sys.executable, "-c", code], start_new_session=True, check=True)
        time.sleep(600)
        return estimate


class Allocates(_Accident):
    name = "allocates"

    def accident(self, estimate: Estimate) -> Estimate:
        np.ones(2**31, np.uint8)
        return estimate


class Searches(Good):
    """Looks for the truth and the data in its own process."""

    name = "searches"

    def estimate(self, observation: Observation) -> Estimate:
        secret = Path(os.environ["CALLS"] + ".secret").read_text()
        frames, frame = [], sys._getframe(1)
        while frame:
            frames.append(repr(frame.f_locals))
            frame = frame.f_back
        places = {
            "arguments": Path("/proc/self/cmdline").read_text() + repr(sys.argv),
            "environment": repr({**os.environ, "PYTEST_CURRENT_TEST": ""}),
            "folder": str(Path.cwd()),
            "frames": repr(frames),
            "objects": repr([type(x).__name__ for x in gc.get_objects()
                             if type(x).__name__ in ("State", "Sequence", "Dataset", "Truth")]),
        }
        found = [name for name, text in places.items() if secret in text]
        assert not found, found
        assert places["objects"] == "[]", places["objects"]
        return super().estimate(observation)


class Tampers(Good):
    """Writes the first sequence over the second one, so that another truth is scored."""

    name = "tampers"

    def estimate(self, observation: Observation) -> Estimate:
        folder = Path(os.environ["CALLS"] + ".data")
        if folder.exists():
            sequences = Path(folder.read_text()) / "sequences"
            (sequences / "000001.zip").write_bytes((sequences / "000002.zip").read_bytes())
        return super().estimate(observation)


class AlwaysRaises(Good):
    name = "always-raises"

    def estimate(self, observation: Observation) -> Estimate:
        raise ZeroDivisionError("always")


class Levels(Good):
    name = "levels"
    inputs, knowledge = ("rgb", "rgbd"), ("free", "axes")


class Knows(Good):
    """Gets the model of the object."""

    knowledge = ("model",)


class SurrogateName(Good):
    name = "mine\ud800"


class ExitsAtStart(Good):
    def __init__(self) -> None:
        raise SystemExit(0)


class DiesTwice(_Accident):
    """Dies at the second sequence, and as often as TIMES says when it is loaded again."""

    name = "dies-twice"

    def __init__(self) -> None:
        died = Path(os.environ["CALLS"] + "-died")
        if died.exists() and len(died.read_text()) <= int(os.environ["TIMES"]):
            self.accident(Estimate(np.zeros((1, 1))))

    def accident(self, estimate: Estimate) -> Estimate:
        with Path(os.environ["CALLS"] + "-died").open("a") as file:
            file.write("x")
        os._exit(9)


class NoMethod:
    name = "no-method"


class CannotStart(Good):
    def __init__(self) -> None:
        raise FileNotFoundError("weights.safetensors")
