"""One sequence on disk: written frame by frame, completely or not at all, and read lazily.

The writer uses a temporary name without `.zip`, flushes the file and renames it: a file whose name
ends in `.zip` is complete. Equal sequences give equal bytes.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.files import temporary_name
from ...robots.geometry import Array
from ..runtime import Archive, ArchiveWriter, open_archive
from ..types import Frame, Meta, Sequence, State
from . import codec, codes
from .lazy_images import Item, LazyStack
from .schema import MAX_META, dump_meta, parse_meta
from .state_arrays import dump_state, parse_state

SEQUENCES_FOLDER = "sequences"
"""Folder of the sequences in a dataset."""
_AHEAD = 4  # frames that wait for encoding at most: bounds the memory
_ENCODERS: dict[str, Callable[[Any], bytes]] = {
    "flow": codec.encode_flow, "flow_backward": codec.encode_flow,
    "visibility": codec.encode_labels, "normal": codec.encode_normal,
}
"""Images that not every frame has."""


def sequence_name(index: int) -> str:
    """Return the name of a sequence: "000007" for 7."""
    return f"{index:06d}"


def image_times(meta: Meta) -> dict[str, range]:
    """Return the frames that have an image, by the image's name."""
    every, forward = range(meta.frames), range(meta.frames - 1)
    times = {
        "rgb": every,
        "depth": every,
        "part": every,
        "flow": forward,
        "flow_backward": range(1, meta.frames),
        "visibility": forward,
    } | {name: every for name in ("normal", "coordinates") if name in meta.layers}
    return {name: numbers for name, numbers in times.items() if name not in meta.omitted}


def image_member(name: str, t: int) -> str:
    """Return the name of the member that holds an image of frame t."""
    return f"{name}/{t:06d}.png"


class SequenceWriter:
    """Writer of DATASET/sequences/INDEX.zip. Encodes in a thread while the next frame is rendered.

    `with SequenceWriter(dataset, index) as writer:` removes the file if the body raises.
    """

    def __init__(
        self, dataset: Path, index: int, depth_unit: float = codes.DEPTH_UNIT,
        coordinate_box: Array | None = None,
    ) -> None:
        """`coordinate_box` [P 2 3] m is required if the frames have coordinates."""
        folder = dataset / SEQUENCES_FOLDER
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / f"{sequence_name(index)}.zip"
        self._temporary = temporary_name(self.path)
        self._file = self._temporary.open("wb")
        self._archive = ArchiveWriter(self._file)
        self._index, self._depth_unit, self._box = index, depth_unit, coordinate_box
        self._thread = ThreadPoolExecutor(1, "encode")
        self._pending: deque[Future[None]] = deque()
        self._frames = 0
        self._parts: list[bytes] = []
        self._members: set[str] = set()

    def add(self, frame: Frame) -> None:
        """Encode the next frame. Its arrays must not change afterwards.

        Raises RenderError if a frame cannot be encoded (`codec.encode_depth`).
        """
        while len(self._pending) >= _AHEAD:
            self._pending.popleft().result()
        self._pending.append(self._thread.submit(self._encode, self._frames, frame))
        self._frames += 1

    def finish(self, meta: Meta, state: State) -> Path:
        """Write the remaining members, rename the file, and return its path.

        Raises ValueError if meta and state do not belong to the frames.
        """
        while self._pending:
            self._pending.popleft().result()
        mine = (self._frames, self._index, self._depth_unit)
        if (meta.frames, meta.index, meta.depth_unit) != mine:
            raise ValueError("meta's frames, index or depth_unit are not those of the writer")
        wide = len(meta.part_names) > 255
        for t, png in enumerate(self._parts):
            self._add("part", t, codec.widen_part(png) if wide else png)
        times = image_times(meta)
        expected = {image_member(name, t) for name in times for t in times[name]}
        if self._members != expected:
            raise ValueError(f"missing or surplus images: {sorted(self._members ^ expected)}")
        self._archive.add("state.npz", dump_state(state, meta))
        self._archive.add("meta.json", dump_meta(meta))
        self._archive.close()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self._thread.shutdown()
        self._temporary.replace(self.path)
        return self.path

    def __enter__(self) -> SequenceWriter:
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the file, unless it is finished."""
        self._thread.shutdown(cancel_futures=True)
        with suppress(OSError):  # the disk may be full
            self._archive.close()
        with suppress(OSError):
            self._file.close()
        self._temporary.unlink(missing_ok=True)

    def _encode(self, t: int, frame: Frame) -> None:
        """Encode and append the members of one frame; runs in the thread."""
        self._add("rgb", t, codec.encode_rgb(frame.rgb))
        self._add("depth", t, codec.encode_depth(frame.depth, self._depth_unit))
        for name, encode in _ENCODERS.items():
            if (image := getattr(frame, name)) is not None:
                self._add(name, t, encode(image))
        if frame.coordinates is not None:
            if self._box is None:
                raise ValueError("coordinates need the writer's coordinate_box")
            coded = codec.encode_coordinates(frame.coordinates, frame.part, self._box)
            self._add("coordinates", t, coded)
        # `finish` knows the number of parts, and with it the width of a label.
        self._parts.append(codec.encode_part(frame.part, wide=bool(frame.part.max() > 255)))

    def _add(self, name: str, t: int, data: bytes) -> None:
        member = image_member(name, t)
        self._members.add(member)
        self._archive.add(member, data)


def read_meta(path: Path) -> Meta:
    """Return only the meta of the sequence at `path`. Raises DatasetError like `open_sequence`."""
    return _read_meta(open_archive(path))


def _read_meta(archive: Archive) -> Meta:
    return parse_meta(archive.read("meta.json", MAX_META), archive.where("meta.json"))


def open_sequence(path: str | Path) -> Sequence:
    """Open the sequence in a ZIP file or unpacked folder. Images are decoded when indexed.

    Raises DatasetError with file and member if a member is missing, damaged or violates the
    dataset contract. Images are checked when they are decoded.
    """
    archive = open_archive(Path(path))
    meta = _read_meta(archive)
    times = image_times(meta)
    archive.require(image_member(name, t) for name in times for t in times[name])
    state = parse_state(archive.read("state.npz"), meta, archive.where("state.npz"))
    size, plane = (meta.width, meta.height), (meta.height, meta.width)

    def open_stored(
        name: str, decode: Callable[..., NDArray[Item]], dtype: type[Item], *channels: int,
    ) -> LazyStack[Item] | None:
        return lazy(name, decode, dtype, *channels) if name in times else None

    def lazy(
        name: str, decode: Callable[..., NDArray[Item]], dtype: type[Item], *channels: int,
        **arguments: Any,
    ) -> LazyStack[Item]:
        load = partial(_load, archive, name, times[name], partial(decode, size=size, **arguments))
        return LazyStack(load, (len(times[name]), *plane, *channels), np.dtype(dtype))

    part = lazy("part", codec.decode_part, np.uint16, parts=len(meta.part_names))
    coordinates = None
    if state.coordinate_box is not None:
        shares = lazy("coordinates", codec.decode_shares, np.float32, 3)
        load = partial(_load_coordinates, shares, part, state.coordinate_box)
        coordinates = LazyStack(load, shares.shape, shares.dtype)
    return Sequence(
        meta=meta,
        state=state,
        rgb=lazy("rgb", codec.decode_rgb, np.uint8, 3),
        depth=lazy("depth", codec.decode_depth, np.float32, unit=meta.depth_unit),
        part=part,
        flow=open_stored("flow", codec.decode_flow, np.float32, 2),
        flow_backward=open_stored("flow_backward", codec.decode_flow, np.float32, 2),
        visibility=open_stored("visibility", codec.decode_visibility, np.uint8),
        normal=open_stored("normal", codec.decode_normal, np.float32, 3),
        coordinates=coordinates,
    )


def _load(
    archive: Archive, name: str, times: range, decode: Callable[..., NDArray[Item]], i: int
) -> NDArray[Item]:
    member = image_member(name, times[i])
    return decode(archive.read(member), where=archive.where(member))


def _load_coordinates(
    shares: LazyStack[np.float32], part: LazyStack[np.uint16], box: Array, t: int
) -> NDArray[np.float32]:
    return codes.coordinates_in_boxes(shares[t], part[t], box)
