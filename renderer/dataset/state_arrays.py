"""`state.npz`: a sequence's exact arrays as bytes, and back, checked."""

from __future__ import annotations

import dataclasses
import io
import math
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import GcbenchError
from ..runtime import ArchiveWriter
from ..types import Meta, State

_INTEGERS = ("joint_parent_part", "joint_child_part", "part_pixels", "keypoint_part",
             "track_part", "track_query")
_FLAGS = ("keypoint_visible", "track_visible")
_MAY_BE_UNKNOWN = ("keypoint_image", "track_image")  # NaN behind the camera


def dump_state(state: State) -> bytes:
    """The bytes of `state.npz`."""
    buffer = io.BytesIO()
    archive = ArchiveWriter(buffer)
    for field in dataclasses.fields(state):
        value = getattr(state, field.name)
        if value is None:
            continue
        member = io.BytesIO()
        array = np.ascontiguousarray(value, _dtype(field.name))
        np.lib.format.write_array(member, array, version=(1, 0), allow_pickle=False)
        archive.add(f"{field.name}.npy", member.getvalue())
    archive.close()
    return buffer.getvalue()


def parse_state(data: bytes, meta: Meta, where: str) -> State:
    """State from the bytes of `state.npz`; arrays that this version does not know are ignored.

    Raises GcbenchError, beginning with `where`, unless the arrays fit `meta` and are finite.
    """
    shapes = state_shapes(meta)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            arrays = {key: _array(archive, key, shapes[key], where) for key in shapes}
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError) as error:
        raise GcbenchError(f"{where}: not a whole NPZ file ({error})") from error
    parts = len(meta.part_names)
    bounds = {
        "joint_parent_part": (0, parts),
        "joint_child_part": (1, parts),
        "part_pixels": (0, meta.width * meta.height),
        "keypoint_part": (1, parts),
        "track_part": (1, parts),
        "track_query": (0, meta.frames - 1),
    }
    for key, (low, high) in bounds.items():
        values = arrays.get(key, np.zeros(0))
        if values.size and not low <= values.min() <= values.max() <= high:
            raise GcbenchError(f"{where}: {key} is not within {low}..{high}")
    return State(**arrays)


def check_state(state: State, meta: Meta) -> None:
    """Raises ValueError unless the arrays have the shapes that belong to `meta`."""
    for key, shape in state_shapes(meta).items():
        if getattr(state, key) is None or np.shape(getattr(state, key)) != shape:
            raise ValueError(f"{key} has shape {np.shape(getattr(state, key))}, expected {shape}")


def state_shapes(meta: Meta) -> dict[str, tuple[int, ...]]:
    """Shape of each array of `state.npz`."""
    frames, joints, parts = meta.frames, len(meta.joint_names), len(meta.part_names)
    shapes: dict[str, tuple[int, ...]] = {
        "times": (frames,),
        "joint_positions": (frames, joints),
        "intrinsics": (3, 3),
        "cam_from_world": (frames, 4, 4),
        "world_from_part": (frames, parts, 4, 4),
        "joint_screw": (frames, joints, 6),
        "joint_parent_part": (joints,),
        "joint_child_part": (joints,),
        "part_pixels": (frames, parts),
    }
    if "coordinates" in meta.layers:
        shapes["coordinate_box"] = (parts, 2, 3)
    for layer, kind, n in (("keypoints", "keypoint", len(meta.keypoint_names)),
                           ("tracks", "track", meta.tracks)):
        if layer in meta.layers:
            shapes |= {f"{kind}_part": (n,), f"{kind}_world": (frames, n, 3),
                       f"{kind}_image": (frames, n, 2), f"{kind}_visible": (frames, n)}
    if "tracks" in meta.layers:
        shapes["track_query"] = (meta.tracks,)
    return shapes


def _array(archive: zipfile.ZipFile, key: str, shape: tuple[int, ...], where: str) -> NDArray[Any]:
    """One array, whose declared shape and dtype are looked at before anything is allocated."""
    size = 8 * math.prod(shape) + 4096  # and a header
    try:
        with archive.open(f"{key}.npy") as file:
            data = file.read(size + 1)
        member = io.BytesIO(data)
        version = np.lib.format.read_magic(member)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else None
        read = np.lib.format.read_array_header_2_0 if version == (2, 0) else read
        if read is None:
            raise GcbenchError(f"{where}: {key} has an NPY version that is not known")
        declared, _, dtype = read(member)
        expected = np.dtype(_dtype(key))
        kinds = "iu" if expected.kind == "i" else expected.kind
        if declared != shape or dtype.kind not in kinds or dtype.itemsize > 8:
            raise GcbenchError(
                f"{where}: {key} is {dtype} {list(declared)}, "
                f"expected {expected} {list(shape)}"
            )
        member.seek(0)
        array = np.lib.format.read_array(member, allow_pickle=False)
    except KeyError as error:
        raise GcbenchError(f"{where}: no {key!r}") from error
    except (ValueError, TypeError, SyntaxError) as error:
        raise GcbenchError(f"{where}: {key} is damaged") from error
    if key not in _MAY_BE_UNKNOWN and not np.isfinite(array).all():
        raise GcbenchError(f"{where}: {key} is not finite")
    return array.astype(expected)


def _dtype(key: str) -> type[np.generic]:
    if key in _FLAGS:
        return np.bool_
    return np.int64 if key in _INTEGERS else np.float64
