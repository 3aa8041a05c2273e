"""Methods that misbehave, by FILE.py:NAME; those in between their accidents are good.

The environment variable CALLS names a file that counts the calls.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

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


class NoMethod:
    name = "no-method"


class CannotStart(Good):
    def __init__(self) -> None:
        raise FileNotFoundError("weights.safetensors")
