"""Methods for another Python, where gcbench is not installed."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

import gcbench as gb
import numpy as np


class Here:
    """Says in its estimate what it has seen: the sequence's number, and a module's number."""

    name, version, training = "here", "2", "none"
    inputs, knowledge = ("rgbd",), ("axes", "model")
    authors, link, date = "A. Author", "https://example.org/@a", "2024-05-01"

    def __init__(self, weights: str = "") -> None:
        import only_there

        self.factor = only_there.FACTOR
        self.name += f" {weights}" * bool(weights)

    def estimate(self, observation: gb.Observation) -> gb.Estimate:
        frames, joints = len(observation.times), observation.n_joints
        assert observation.depth.dtype == np.float32 and observation.rgb.dtype == np.uint8
        assert observation.depth.shape == observation.rgb.shape[:3] == (frames, 36, 48)
        assert observation.cam_from_world.shape == (4, 4) and observation.model is None
        assert observation.axis_line is None and observation.parents.shape == (joints,)
        assert isinstance(observation, gb.Observation) and not hasattr(gb, "load_robot")
        assert "torch" not in sys.modules
        assert os.path.samestat(os.fstat(0), Path(os.devnull).stat())
        observation.rgb[0] = 0  # a copy of its own
        print("to the log, not to gcbench")
        steps = np.arange(frames)[:, None] * np.ones(joints)
        return gb.Estimate(self.factor * steps, part=np.zeros((frames, 36, 48), np.int64))


class Accidents:
    """Something else happens to each sequence; the first is good."""

    name, version, training = "accidents", "1", "none"
    inputs, knowledge = ("rgb",), ("free",)

    def estimate(self, observation: gb.Observation) -> object:
        good = gb.Estimate(np.zeros((len(observation.times), observation.n_joints)))
        accident = ACCIDENTS[int(observation.rgb[0, 0, 0, 0])]
        return good if accident is None else accident(good)


def raises(_: object) -> None:
    raise ZeroDivisionError("of the method \ud800")


def dies(_: object) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def exits(_: object) -> None:
    os.write(2, b"out of luck\n")
    os._exit(7)


def leaves_a_copy(_: object) -> None:
    copy = os.fork()
    if copy == 0:
        time.sleep(600)
    Path(os.environ["COPY"]).write_text(str(copy))
    os._exit(0)


def hangs(_: object) -> None:
    time.sleep(600)


def sends(data: bytes) -> object:
    """Send this in place of an answer."""

    def write(stream: object, header: dict, arrays: dict) -> None:
        stream.write(data)
        stream.flush()
        time.sleep(600)

    def accident(good: object) -> object:
        sys.modules["__main__"].write_message = write
        return good

    return accident


def message(arrays: list, **header: object) -> bytes:
    fields = {"status": "ok", "reason": "", "seconds": 0.1, "peak_memory": None}
    text = json.dumps({**fields, **header, "arrays": arrays}).encode()
    return len(text).to_bytes(4, "big") + text


class Trap:
    @property
    def displacement(self) -> None:
        raise SystemExit(0)


ACCIDENTS = (
    None, raises, dies, exits, leaves_a_copy, hangs,
    lambda good: gb.Estimate(good.displacement[:, :1]),
    lambda good: "an estimate",
    lambda good: gb.Estimate(good.displacement + 1j),
    lambda good: gb.Estimate([None]),
    lambda good: Trap(),
    lambda good: gb.Estimate(good.displacement * np.nan),
    sends(b"\xff\xff\xff\xff"),
    sends(b"\0\0\0\1{"),
    sends(message([["displacement", "<f8", [2**20, 2**20]]])),
    sends(message([["displacement", "|O8", [4, 2]]])),
    sends(message([["__class__", "<f8", [1]]])),
    sends(message([["displacement", "<f8", [-4, 2]]])),
    sends(message([], status="perfect")),
    sends(message([], seconds=-1.0)),
    sends(message([], seconds=1e300)),
)


class SendsNoDeclaration:
    def __init__(self) -> None:
        sends(b"\0\0\0\2[]")(None)


class NoVersion(Accidents):
    version = 3


class NeedsModel(Accidents):
    knowledge = ("model",)


class NeedsTorch(Accidents):
    def __init__(self) -> None:
        import torch  # noqa: F401
