"""A source of sequences without OpenGL, for tests of what is around it: fast, and exact.

A sequence is a function of (config, index). `config.robot` may order an accident:
"crash=INDEX:FILE" kills the process while it renders that sequence, until FILE exists;
"crash=INDEX:" always; "error=INDEX" raises a GcbenchError; "bug=INDEX" a ZeroDivisionError.
The environment variable FAKE_SECONDS makes each frame take so long.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from gcbench import GcbenchError
from gcbench.renderer.generate.rendered_sequence import RenderedSequence
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.types.sequence import Frame, Meta, State

PARTS, JOINTS = 3, 2


def make_frames(rng: np.random.Generator, frames: int, height: int, width: int) -> list[Frame]:
    """Frames of random images that the encodings hold."""

    def image(t: int) -> Frame:
        flow = rng.normal(0, 20, (2, height, width, 2)).astype(np.float32)
        flow[:, :2] = np.nan
        flow[:, 2:4] = 0
        last = t == frames - 1
        return Frame(
            rgb=rng.integers(0, 256, (height, width, 3), np.uint8),
            depth=rng.uniform(0, 6.5, (height, width)).astype(np.float32),
            part=rng.integers(0, PARTS + 1, (height, width)).astype(np.uint16),
            flow=None if last else flow[0],
            flow_backward=flow[1] if t else None,
            visibility=None if last else rng.integers(0, 4, (height, width), np.uint8),
        )

    return [image(t) for t in range(frames)]


def make_state(rng: np.random.Generator, frames: int) -> State:
    """A state of the right shapes."""
    return State(
        times=np.arange(frames) / 30,
        joint_positions=rng.normal(size=(frames, JOINTS)),
        intrinsics=np.array([[50.0, 0, 15], [0, 50, 11], [0, 0, 1]]),
        cam_from_world=rng.normal(size=(frames, 4, 4)),
        world_from_part=rng.normal(size=(frames, PARTS, 4, 4)),
        joint_screw=rng.normal(size=(frames, JOINTS, 6)),
        joint_parent_part=np.array([1, 2]),
        joint_child_part=np.array([2, 3]),
        part_pixels=rng.integers(0, 100, (frames, PARTS)),
    )


def make_meta(frames: int, height: int, width: int, **changes: Any) -> Meta:
    """A meta that belongs to them."""
    values: dict[str, Any] = {
        "name": "000000",
        "asset": {"name": "fake", "licence": "MIT", "sha256": ""},
        "joint_names": ("elbow", "slide"),
        "joint_types": ("revolute", "prismatic"),
        "joint_limits": (None, (0.0, 0.5)),
        "part_names": ("base", "arm", "drawer"),
        "scored_joints": ("elbow",),
        "width": width,
        "height": height,
        "frames": frames,
        "seed": 0,
        "index": 0,
        "randomization": {"lights": [1.0, 2.0]},
        "renderer": {"renderer": "none"},
        "observability": {},
    }
    return Meta(**(values | changes))


def render(config: RenderConfig, index: int) -> RenderedSequence:
    """A sequence of random images."""
    size = (config.frames, config.height, config.width)
    rng = np.random.default_rng([config.seed, index])

    def frames() -> Iterator[Frame]:
        for t, frame in enumerate(make_frames(rng, *size)):
            if t == 1:
                _accident(config.robot, index)
            time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
            yield frame

    def finish() -> tuple[Meta, State]:
        seen = {"observable": index % 4 != 2, "refused": {"collision": index % 3}}
        meta = make_meta(
            *size, name=f"{index:06d}", index=index, seed=config.seed, observability=seen
        )
        return meta, make_state(rng, config.frames)

    return RenderedSequence(frames(), 0.0001, None, finish)


class FakeRenderer:
    """A renderer without OpenGL."""

    def __init__(self, config: RenderConfig) -> None:
        if config.robot == "nowhere":
            raise GcbenchError("no robot 'nowhere'")
        self.config = config
        self.asset = {"name": config.robot, "licence": "MIT", "sha256": "00"}

    def render(self, index: int) -> RenderedSequence:
        return render(self.config, index)

    def close(self) -> None:
        pass


def _accident(robot: str, index: int) -> None:
    kind, _, rest = robot.partition("=")
    number, _, marker = rest.partition(":")
    if not number.isdecimal() or int(number) != index:
        return
    if kind == "error":
        raise GcbenchError("the light went out")
    if kind == "bug":
        raise ZeroDivisionError("of a bug")
    if kind == "crash" and not (marker and Path(marker).exists()):
        if marker:
            Path(marker).touch()
        os.kill(os.getpid(), signal.SIGSEGV)
