"""The HDF5 file that the code of ScrewNet reads: `complete_data.hdf5` holds for each object

    obj_000000/depth_imgs             float32 [16 108 192], m / 12; 0: no surface
    obj_000000/moving_frame_in_world  float64 [16 7], the moving part: x y z (m), qw qx qy qz
    obj_000000/embedding_and_params   float64 [7], the part that carries it, likewise, in frame 0
    obj_000000/global_labels          float64 [15 8], of DUST-net: l, m = p x l, theta (rad), d (m)
                                      of the motion from frame 0; m is 0 where the joint slides

and as attributes `sequence` (its name in the dataset) and `joint_type`. The world of the file is
the camera frame of frame 0: each sequence has a camera of its own, and a network sees no other
frame. theta and d are never negative, theta is at most pi: the axis carries the sign. The images
are the first 16, reduced as a whole by the nearest pixel, with zeros beside them.

Sources: Jain et al., "ScrewNet" (ICRA 2021), and "Distributional depth-based estimation of object
articulation models" (CoRL 2021), with the loaders of their public code.
"""

# h5py is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportMissingModuleSource=false

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...robots.geometry import Array, fit_depth, quaternion_from_rotation
from ..dataset import Dataset
from ..runtime import Archive, address
from ..types import Sequence
from .writer import SequenceRecord, Writer

_FRAMES = 16


class ScrewNetData(Writer):
    """See `Writer`. Objects are files of their own until all are there: an HDF5 file that is open
    when the process is killed may be lost as a whole."""

    def __init__(self, folder: Path, dataset: Dataset) -> None:
        super().__init__(folder, dataset)
        self._objects = folder / "objects"
        self._objects.mkdir(exist_ok=True)
        self._names: list[str] = []

    def add(self, sequence: Sequence, archive: Archive) -> SequenceRecord:
        meta, s = sequence.meta, sequence.state
        joints = [meta.joint_names.index(name) for name in meta.scored_joints]
        carrier = int(s.joint_parent_part[joints[0]]) - 1 if len(joints) == 1 else -1
        if carrier < 0 or len(sequence) < _FRAMES:
            raise DatasetError(f"{address(archive.path)}: ScrewNet reads {_FRAMES} frames of one "
                               f"joint between two parts; here are {len(sequence)} frames, "
                               f"{len(joints)} scored joints; render an appliance with --frames 16")
        world_from_part = s.cam_from_world[0] @ s.world_from_part[:_FRAMES]
        moving = world_from_part[:, int(s.joint_child_part[joints[0]]) - 1]
        fields: dict[str, NDArray[Any]] = {
            "moving_frame_in_world": _poses(moving),
            "embedding_and_params": _poses(world_from_part[:1, carrier])[0],
            "global_labels": _labels(sequence, joints[0]),
        }
        with h5py.File(self._objects / f"{archive.path.stem}.hdf5", "w") as file:
            depth = fit_depth(np.stack(list(sequence.depth[:_FRAMES])))
            file.create_dataset("depth_imgs", data=depth, compression="gzip", compression_opts=1)
            for name, values in fields.items():
                file.create_dataset(name, data=values)
            file.attrs["sequence"] = archive.path.stem
            file.attrs["joint_type"] = meta.joint_types[joints[0]]
        return {"sequence": archive.path.stem}

    def keep(self, record: SequenceRecord) -> None:
        self._names.append(record["sequence"])

    def finish(self) -> None:
        whole = self.folder / "complete_data.hdf5"
        if not whole.exists():
            part = whole.with_suffix(".part")
            with h5py.File(part, "w") as file:
                for k, name in enumerate(self._names):
                    with h5py.File(self._objects / f"{name}.hdf5", "r") as one:
                        one.copy("/", file, f"obj_{k:06d}")
            part.rename(whole)
        shutil.rmtree(self._objects)


def _poses(transforms: Array) -> Array:
    """Return transforms [N 4 4] as positions and quaternions [N 7] with w first."""
    turns = np.roll(quaternion_from_rotation(transforms[:, :3, :3]), 1, axis=1)
    return np.concatenate([transforms[:, :3, 3], turns], axis=1)


def _labels(sequence: Sequence, joint: int) -> Array:
    """Return the screws [15 8] of the motion from frame 0 to each later one."""
    s = sequence.state
    moved = s.joint_positions[1:_FRAMES, joint] - s.joint_positions[0, joint]
    slides = sequence.meta.joint_types[joint] == "prismatic"
    if not slides:
        moved = np.pi - np.mod(np.pi - moved, 2 * np.pi)
    line = np.where(moved < 0, -1.0, 1.0)[:, None] * s.joint_screw[0, joint]
    size = np.abs(moved)
    return np.column_stack([line, size * (not slides), size * slides])
