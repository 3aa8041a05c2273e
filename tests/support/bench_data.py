"""Small datasets for tests of the benchmark, with known motion."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np
from gcbench.renderer.dataset.provenance import new_provenance, write_provenance
from gcbench.renderer.dataset.reader import open_dataset
from gcbench.renderer.dataset.storage import SequenceWriter
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.types.sequence import Sequence

from . import analytic

JOINTS = 2


def make_dataset(
    folder: Path, n: int = 3, unobservable: tuple[int, ...] = (),
    stream: Literal["test", "train"] = "test",
) -> Path:
    """n sequences of an arm of two revolute joints, each of its own amount of motion."""
    base = analytic.render(width=48, height=36, frames=4, room=False)
    config = RenderConfig(robot="arm", frames=4, width=48, height=36, stream=stream)
    write = new_provenance(config)
    for index in range(n):
        save(base, folder, index, 1.0 + index, index not in unobservable)
    counts = {"sequences": n, "frames": 4 * n, "unobservable": len(unobservable), "refused": {}}
    asset = {"name": "arm", "source": "test", "licence": "MIT", "sha256": "", "notes": []}
    write_provenance(folder, dataclasses.replace(write, assets=(asset,), counts=counts))
    return folder


def save(base: Sequence, folder: Path, index: int, faster: float, observable: bool) -> None:
    """The sequence with joint positions that move `faster` times (images as they are,
    but for the first pixel, which is `index`)."""
    q = base.state.joint_positions
    state = dataclasses.replace(base.state, joint_positions=q[:1] + faster * (q - q[:1]))
    seen = {**base.meta.observability, "observable": observable}
    meta = dataclasses.replace(
        base.meta, name=f"{index:06d}", index=index, seed=5, observability=seen
    )
    with SequenceWriter(folder, index, meta.depth_unit, state.coordinate_box) as writer:
        for frame in dataclasses.replace(base, meta=meta, state=state):
            rgb = frame.rgb.copy()
            rgb[0, 0] = index
            writer.add(dataclasses.replace(frame, rgb=rgb))
        writer.finish(meta, state)


def truth(folder: Path, index: int) -> np.ndarray:
    """[T J] of the scored joints."""
    q = open_dataset(folder)[index].state.joint_positions[:, :JOINTS]
    return q - q[0]
