"""Shards of WebDataset: tar files of at most SHARD frames, a frame is one sample.

    SSSSSS_TTTTTT.json            names, times, poses, joints, camera: what is exact of a frame
    SSSSSS_TTTTTT.rgb.png         and depth, part, flow, flow_backward, visibility: the PNGs of
                                  docs/reference/dataset_format.md

and the optional layers that the dataset has. The images are those of the dataset, byte for byte;
flow_backward is absent in a sequence's first frame, flow and visibility are in its last.
"""

from __future__ import annotations

import io
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dataset import Dataset, image_member, image_times
from ..runtime import Archive, dump_json
from ..types import Sequence
from .writer import SequenceRecord, Writer

SHARD = 1000
"""Frames."""


class WebDataset(Writer):
    """See `Writer`."""

    def __init__(self, folder: Path, dataset: Dataset) -> None:
        super().__init__(folder, dataset)
        self._name = dataset.path.absolute().name
        self._tar: tarfile.TarFile | None = None
        self._frames = 0
        """In all shards."""
        self._size = 0
        """Bytes of the shard that is not full yet, without the mark of its end."""

    def add(self, sequence: Sequence, archive: Archive) -> dict[str, Any]:
        images = image_times(len(sequence), sequence.meta.layers)
        frames, size = self._frames, self._size
        for t in range(len(sequence)):
            if self._tar is None:
                self._tar = self._shard(frames, size)
            name = archive.path.stem
            key = f"{name}_{t:06d}"
            facts = {"sequence": name, **frame_facts(sequence, t)}
            _add(self._tar, f"{key}.json", dump_json(facts))
            for kind, times in images.items():
                if t in times:
                    _add(self._tar, f"{key}.{kind}.png", archive.read(image_member(kind, t)))
            frames += 1
            size = self._tar.offset
            if frames % SHARD == 0:
                self.close()
                size = 0
        if self._tar is not None:
            self._tar.fileobj.flush()  # pyright: ignore
        return {"frames": frames, "size": size}

    def keep(self, record: SequenceRecord) -> None:
        self._frames, self._size = record["frames"], record["size"]

    def finish(self) -> None:
        if self._tar is None and self._size:  # a run was stopped after its last sequence
            self._tar = self._shard(self._frames, self._size)
        self.close()

    def close(self) -> None:
        if self._tar is not None:
            file: Any = self._tar.fileobj
            self._tar.close()
            file.close()
            self._tar = None

    def _shard(self, frames: int, size: int) -> tarfile.TarFile:
        """The shard of the frame with that number; it is truncated to `size` bytes."""
        path = self.folder / f"{self._name}-{frames // SHARD:06d}.tar"
        file = path.open("r+b" if size else "wb")
        file.truncate(size)
        file.seek(size)
        return tarfile.open(fileobj=file, mode="w")


def _add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)  # with time zero and no owner: equal frames, equal bytes
    entry.size = len(data)
    tar.addfile(entry, io.BytesIO(data))


def frame_facts(sequence: Sequence, t: int) -> dict[str, object]:
    """The exact values of frame t, with the names that are needed to read them."""
    meta = sequence.meta
    return {
        "frame": t, "frames": meta.frames, "asset": dict(meta.asset), "width": meta.width,
        "height": meta.height, "depth_unit": meta.depth_unit,
        "joint_names": meta.joint_names, "joint_types": meta.joint_types,
        "scored_joints": meta.scored_joints, "part_names": meta.part_names,
        "keypoint_names": meta.keypoint_names,
        **{name: known(array) for name, array in sequence.state.at(t).items()},
    }  # fmt: skip



def known(array: NDArray[Any]) -> Any:
    """The array as lists or a number, None where it is NaN, which JSON does not have."""
    if array.dtype.kind != "f" or np.isfinite(array).all():
        return array.tolist()
    out = array.astype(object)
    out[np.isnan(array)] = None
    return out.tolist()
