"""Shards of WebDataset: tar files of at most SHARD frames, a frame is one sample.

    SSSSSS_TTTTTT.json               names, times, poses, joints, camera: what is exact of a frame
    SSSSSS_TTTTTT.rgb.png            the image of the dataset, byte for byte
    SSSSSS_TTTTTT.depth.npy.gz       float32 [H W] m; 0: no surface
    SSSSSS_TTTTTT.part.npy.gz        uint16 [H W]; 0: background
    SSSSSS_TTTTTT.flow.npy.gz        float32 [H W 2] px; NaN: unknown; also flow_backward
    SSSSSS_TTTTTT.visibility.npy.gz  uint8 [H W]; UNKNOWN in the last frame

and normal and coordinates, float32 [H W 3] with NaN, where the dataset has them. Flow and
visibility are left out where it has none. All samples have the same keys: the flow of a last frame
and the backward flow of a first one are NaN everywhere.

Only the video is an image. Many image decoders reduce PNGs to 8 bits without a warning, which
would change depth and flow.
"""

from __future__ import annotations

import gzip
import io
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dataset import Dataset, image_member, image_times
from ..runtime import Archive, dump_json, dump_npy
from ..types import Sequence
from .writer import SequenceRecord, Writer

SHARD = 1000
"""Frames."""
UNKNOWN = 255
"""Visibility where there is no next frame."""


class WebDataset(Writer):
    """See `Writer`."""

    def __init__(self, folder: Path, dataset: Dataset) -> None:
        super().__init__(folder, dataset)
        self._tar: tarfile.TarFile | None = None
        self._frames = 0
        """In all shards."""
        self._size = 0
        """Bytes of the shard that is not full yet, without the mark of its end."""

    def add(self, sequence: Sequence, archive: Archive) -> dict[str, Any]:
        frames, size = self._frames, self._size
        for t in range(len(sequence)):
            if self._tar is None:
                self._tar = self._shard(frames, size)
            name = archive.path.stem
            key = f"{name}_{t:06d}"
            facts = {"sequence": name, **self.facts(sequence, t)}
            _add(self._tar, f"{key}.json", dump_json(facts))
            _add(self._tar, f"{key}.rgb.png", archive.read(image_member("rgb", t)))
            for kind, field in fields_of(sequence, t).items():
                data = gzip.compress(dump_npy(field), compresslevel=1, mtime=0)
                _add(self._tar, f"{key}.{kind}.npy.gz", data)
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
            try:
                self._tar.close()
            finally:
                file.close()
                self._tar = None

    def facts(self, sequence: Sequence, t: int) -> dict[str, object]:
        """Return the exact values of frame t, with the names that are needed to read them."""
        meta = sequence.meta
        return {
            "frame": t, "frames": meta.frames, "asset": dict(meta.asset), "width": meta.width,
            "height": meta.height, "joint_names": meta.joint_names,
            "joint_types": meta.joint_types, "scored_joints": meta.scored_joints,
            "part_names": meta.part_names, "keypoint_names": meta.keypoint_names,
            **{name: json_values(array) for name, array in sequence.state.at(t).items()},
        }

    def shard_path(self, number: int) -> Path:
        """Return the path of a shard."""
        return self.folder / f"{self.dataset.path.absolute().name}-{number:06d}.tar"

    def _shard(self, frames: int, size: int) -> tarfile.TarFile:
        """The shard of the frame with that number; it is truncated to `size` bytes."""
        file = self.shard_path(frames // SHARD).open("r+b" if size else "wb")
        file.truncate(size)
        file.seek(size)
        return tarfile.open(fileobj=file, mode="w")


def _add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)  # with time zero and no owner: equal frames, equal bytes
    entry.size = len(data)
    tar.addfile(entry, io.BytesIO(data))


def fields_of(sequence: Sequence, t: int) -> dict[str, NDArray[Any]]:
    """Return every image of frame t but the video; what a frame lacks is unknown everywhere."""
    frame, meta = sequence.frame(t), sequence.meta
    plane = (meta.height, meta.width)
    unknown = {
        "flow": np.full((*plane, 2), np.nan, np.float32),
        "flow_backward": np.full((*plane, 2), np.nan, np.float32),
        "visibility": np.full(plane, UNKNOWN, np.uint8),
    }
    images = {kind: getattr(frame, kind) for kind in image_times(meta)}
    return {kind: unknown[kind] if image is None else image
            for kind, image in images.items() if kind != "rgb"}


def json_values(array: NDArray[Any]) -> Any:
    """The array as lists or a number, None where it is NaN, which JSON does not have."""
    if array.dtype.kind != "f" or np.isfinite(array).all():
        return array.tolist()
    out = array.astype(object)
    out[np.isnan(array)] = None
    return out.tolist()
