"""`state.npz`: a sequence's exact arrays as bytes, and back, checked."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import DatasetError, RenderError
from ..runtime import ArchiveWriter, ArraySpec, dump_npy, parse_npz
from ..types import Meta, State

MAX_STATE = 2**29
"""Bytes of all arrays of a sequence; more are refused."""
_FAR = 1e9
"""m, rad or px; computations with such numbers do not overflow."""
_LATE = 1e12
"""s; more than the slowest video lasts."""
_OUTSIDE = 1e30
"""px; a point beside the camera projects to a huge number."""
_FOCAL = 1e-6
"""px, the least focal length."""
_KINDS = {"bool": "b", "int64": "iu", "float64": "f"}


@dataclass(frozen=True)
class _Array:
    shape: tuple[int, ...]
    dtype: str = "float64"
    bounds: tuple[float, float] = (-_FAR, _FAR)
    """Least and greatest value."""
    may_be_unknown: bool = False
    """NaN behind the camera."""


def dump_state(state: State, meta: Meta) -> bytes:
    """Return the bytes of `state.npz`.

    Raises ValueError unless the arrays have the shapes that belong to `meta`, and RenderError if
    they are larger than a reader accepts.
    """
    buffer = io.BytesIO()
    archive = ArchiveWriter(buffer)
    arrays = _arrays(meta)
    if (size := _bytes(arrays)) > MAX_STATE:
        raise RenderError(f"the state of {meta.frames} frames takes {size} bytes, more than "
                          f"{MAX_STATE}; render fewer frames or parts")
    for key, expected in arrays.items():
        value: Any = getattr(state, key)
        if np.shape(value) != expected.shape:
            raise ValueError(f"{key} has shape {np.shape(value)}, expected {expected.shape}")
        archive.add(f"{key}.npy", dump_npy(np.asarray(value, expected.dtype)))
    archive.close()
    return buffer.getvalue()


def parse_state(data: bytes, meta: Meta, where: str) -> State:
    """Return the state in the bytes of `state.npz`; unknown arrays are ignored.

    Raises:
        DatasetError: beginning with `where`, unless the arrays fit `meta`, are finite and of usual
            size, and the focal lengths are positive.
    """
    expected = _arrays(meta)
    if _bytes(expected) > MAX_STATE:
        raise DatasetError(f"{where}: the arrays of meta.json's {meta.frames} frames, "
                           f"{len(meta.part_names)} parts and {len(meta.joint_names)} joints are "
                           f"larger than {MAX_STATE} bytes")
    specs = {key: ArraySpec(array.shape, _KINDS[array.dtype]) for key, array in expected.items()}
    found = parse_npz(data, specs, where, stored=True)
    if missing := specs.keys() - found.keys():
        raise DatasetError(f"{where}: no {min(missing)!r}")
    arrays: dict[str, Any] = {}
    for key, array in expected.items():
        arrays[key] = values = found[key].astype(array.dtype)
        finite = np.isfinite(values) | (np.isnan(values) if array.may_be_unknown else False)
        if not finite.all():
            raise DatasetError(f"{where}: {key} is not finite")
        low, high = array.bounds
        if ((values < low) | (values > high)).any():
            raise DatasetError(f"{where}: {key} is not within {low:.9g}..{high:.9g}")
    if not (np.diag(arrays["intrinsics"])[:2] >= _FOCAL).all():
        raise DatasetError(f"{where}: intrinsics have a focal length of less than {_FOCAL:g} px")
    return State(**arrays)


def state_shapes(meta: Meta) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of `state.npz`."""
    return {key: array.shape for key, array in _arrays(meta).items()}


def _bytes(arrays: dict[str, _Array]) -> int:
    return sum(8 * math.prod(array.shape) for array in arrays.values())


def _arrays(meta: Meta) -> dict[str, _Array]:
    """What each array of the sequence must be, in the order of the file."""
    frames, joints, parts = meta.frames, len(meta.joint_names), len(meta.part_names)
    number = (1, parts)
    arrays = {
        "times": _Array((frames,), bounds=(-_LATE, _LATE)),
        "joint_positions": _Array((frames, joints)),
        "intrinsics": _Array((3, 3)),
        "cam_from_world": _Array((frames, 4, 4)),
        "world_from_part": _Array((frames, parts, 4, 4)),
        "joint_screw": _Array((frames, joints, 6)),
        "joint_parent_part": _Array((joints,), "int64", (0, parts)),
        "joint_child_part": _Array((joints,), "int64", number),
        "part_pixels": _Array((frames, parts), "int64", (0, meta.width * meta.height)),
    }
    if "coordinates" in meta.layers:
        arrays["coordinate_box"] = _Array((parts, 2, 3))
    for kind, n in (("keypoint", len(meta.keypoint_names)), ("track", meta.tracks)):
        if f"{kind}s" in meta.layers:
            arrays[f"{kind}_part"] = _Array((n,), "int64", number)
            if kind == "track":
                arrays["track_query"] = _Array((n,), "int64", (0, frames - 1))
            arrays |= {
                f"{kind}_world": _Array((frames, n, 3)),
                f"{kind}_image": _Array((frames, n, 2), bounds=(-_OUTSIDE, _OUTSIDE),
                                        may_be_unknown=True),
                f"{kind}_visible": _Array((frames, n), "bool"),
            }
    return arrays
