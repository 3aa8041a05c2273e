"""`state.npz`: a sequence's exact arrays as bytes, and back, checked."""

from __future__ import annotations

import dataclasses
import io
from typing import Any

import numpy as np

from ...errors import DatasetError
from ..runtime import ArchiveWriter, ArraySpec, dump_npy, parse_npz
from ..types import Meta, State

_INTEGERS = ("joint_parent_part", "joint_child_part", "part_pixels", "keypoint_part",
             "track_part", "track_query")
_FLAGS = ("keypoint_visible", "track_visible")
_MAY_BE_UNKNOWN = ("keypoint_image", "track_image")  # NaN behind the camera


def dump_state(state: State) -> bytes:
    """Return the bytes of `state.npz`."""
    buffer = io.BytesIO()
    archive = ArchiveWriter(buffer)
    for field in dataclasses.fields(state):
        value = getattr(state, field.name)
        if value is not None:
            archive.add(f"{field.name}.npy", dump_npy(np.asarray(value, _dtype(field.name))))
    archive.close()
    return buffer.getvalue()


def parse_state(data: bytes, meta: Meta, where: str) -> State:
    """Return the state in the bytes of `state.npz`; unknown arrays are ignored.

    Raises:
        DatasetError: beginning with `where`, unless the arrays fit `meta` and are finite.
    """
    kinds = {"bool": "b", "int64": "iu", "float64": "f"}
    specs = {key: ArraySpec(shape, kinds[_dtype(key)]) for key, shape in state_shapes(meta).items()}
    found = parse_npz(data, specs, where)
    if missing := specs.keys() - found.keys():
        raise DatasetError(f"{where}: no {min(missing)!r}")
    arrays: dict[str, Any] = {key: found[key].astype(_dtype(key)) for key in specs}
    for key, array in arrays.items():
        if key not in _MAY_BE_UNKNOWN and not np.isfinite(array).all():
            raise DatasetError(f"{where}: {key} is not finite")
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
            raise DatasetError(f"{where}: {key} is not within {low}..{high}")
    return State(**arrays)


def check_state(state: State, meta: Meta) -> None:
    """Raises ValueError unless the arrays have the shapes that belong to `meta`."""
    for key, shape in state_shapes(meta).items():
        if getattr(state, key) is None or np.shape(getattr(state, key)) != shape:
            raise ValueError(f"{key} has shape {np.shape(getattr(state, key))}, expected {shape}")


def state_shapes(meta: Meta) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of `state.npz`."""
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


def _dtype(key: str) -> str:
    if key in _FLAGS:
        return "bool"
    return "int64" if key in _INTEGERS else "float64"
