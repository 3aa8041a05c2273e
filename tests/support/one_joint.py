"""Sequences of an arm of which one joint moves and is scored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from gcbench.renderer.types.sequence import Sequence
from gcbench.robots.model import forward_kinematics

from . import analytic, bench_data


def moved(joint: str, displacement: list[float]) -> Sequence:
    """The arm of the tests, of which one joint moves; its parts have boxes of random sizes."""
    base = analytic.render(width=48, height=36, frames=len(displacement), room=False)
    model = analytic.arm()
    q = np.tile(base.state.joint_positions[:1], (len(displacement), 1))
    q[:, base.meta.joint_names.index(joint)] += displacement
    poses = forward_kinematics(model, q)
    screw = analytic._screws(model, base.state.cam_from_world[0] @ poses)
    corner = np.random.default_rng(0).uniform(0.1, 0.5, (len(base.meta.part_names), 2, 3))
    state = replace(base.state, joint_positions=q, world_from_part=poses, joint_screw=screw,
                    coordinate_box=corner * [[-1], [1]])
    meta = replace(base.meta, scored_joints=(joint,), layers=("coordinates",))
    nowhere = np.full((len(displacement), 36, 48, 3), np.nan, np.float32)
    return replace(base, state=state, meta=meta, coordinates=nowhere)


def dataset(folder: Path, n: int = 4, joints: tuple[str, ...] = ("pan",)) -> Path:
    """A dataset of the stream "train" of objects with one scored joint."""
    folder.mkdir(parents=True)
    bench_data.make_dataset(folder, n, stream="train")
    for index in range(n):
        (folder / f"sequences/{index:06d}.zip").unlink()
        base = moved("pan", [0.0, 0.1, 0.2, 0.3])
        base = replace(base, meta=replace(base.meta, scored_joints=joints))
        bench_data.save(base, folder, index, 1.0 + index, observable=True)
    return folder
