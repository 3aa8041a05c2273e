"""What a method returned for one sequence, on disk: a ZIP of `estimate.json` and `estimate.npz`.

Stored apart from scores, so that a new metric never runs a method again. The JSON holds status,
reason, time and memory; the arrays (absent if the method failed) are those of `Estimate`.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError, MethodError
from ...renderer.runtime import (
    ArchiveWriter,
    ArraySpec,
    dump_json,
    open_archive,
    parse_json,
    parse_npz,
    to_record,
)
from ...renderer.types import Estimate

Status = Literal["ok", "raised", "timeout", "crashed", "invalid"]
STATUSES: tuple[Status, ...] = get_args(Status)
MAX_REASON = 4000
"""Characters of a reason; the end of a longer one is kept."""
_JSON, _ARRAYS, _FORMAT = "estimate.json", "estimate.npz", "gcbench-estimate/2"
_FORMER = ("gcbench-estimate/1",)  # the same without `reliable`
_MAX_BYTES = 2**28
_AT_START = 1e-6  # rad or m: a displacement of frame 0 that counts as none


@dataclass(frozen=True)
class EstimateShape:
    """What the arrays of an estimate must fit: T frames of H x W pixels, J scored joints."""

    frames: int
    joints: int
    height: int
    width: int


@dataclass(frozen=True)
class Stored:
    """One attempt at one sequence."""

    status: Status
    reason: str = ""
    """What went wrong, with the method's last words; empty if nothing did."""
    seconds: float | None = None
    """Of `estimate` alone; None if it is not known."""
    peak_memory: float | None = None
    """Of the process, MiB; None if it is not known."""
    estimate: Estimate | None = None
    """None if it failed."""


class InvalidEstimateError(MethodError):
    """A method returned no estimate of this sequence."""


def validate_estimate(value: Any, shape: EstimateShape) -> Estimate:
    """Return what a method returned, as arrays of the right shapes; numbers may be NaN.

    Raises InvalidEstimateError that names the field, its shape and the expected one.
    """
    if not hasattr(value, "displacement"):
        raise InvalidEstimateError(f"returned {type(value).__name__}, expected gcbench.Estimate")
    t, j = shape.frames, shape.joints
    displacement = _numbers(value, "displacement", (t, j), f"[T J] = [{t} {j}]")
    if displacement is None:
        raise InvalidEstimateError(f"displacement is None, expected [T J] = [{t} {j}]")
    check_start(displacement[0])
    part = getattr(value, "part", None)
    if part is not None:
        expected = (t, shape.height, shape.width)
        part = _array(part, "part")
        if part.shape != expected or part.dtype.kind not in "biu":
            raise InvalidEstimateError(
                f"part is {part.dtype} {list(part.shape)}, expected integers [T H W] = "
                f"{list(expected)}"
            )
        if part.size and not 0 <= int(part.min()) <= int(part.max()) <= j:
            raise InvalidEstimateError(f"part has labels outside 0..{j}")
        part = part.astype(np.uint8)
    sigma = _numbers(value, "sigma", (t, j), f"[T J] = [{t} {j}]")
    if sigma is not None and (sigma < 0).any():
        raise InvalidEstimateError(f"sigma has {sigma[sigma < 0][0]:g}, expected no negative "
                                   "number")
    return Estimate(
        displacement=displacement,
        screw=_numbers(value, "screw", (j, 6), f"[J 6] = [{j} 6]"),
        part=part,
        sigma=sigma,
        reliable=_flags(value, "reliable", j),
    )


def check_start(displacement: NDArray[np.float64]) -> None:
    """Check the displacement [J] of frame 0, rad or m, which may be NaN.

    Raises InvalidEstimateError if it is not 0, as where absolute joint positions are given.
    """
    moved = displacement[np.abs(displacement) > _AT_START]
    if len(moved):
        raise InvalidEstimateError(f"displacement of frame 0 is {moved[0]:g}, expected 0: "
                                   "displacements are since frame 0, subtract those of frame 0")


def _flags(value: Any, name: str, joints: int) -> NDArray[np.bool_] | None:
    given = getattr(value, name, None)
    if given is None:
        return None
    array = _array(given, name)
    if array.shape != (joints,) or array.dtype.kind != "b":
        raise InvalidEstimateError(
            f"{name} is {array.dtype} {list(array.shape)}, expected bool [J] = [{joints}]"
        )
    return array.astype(np.bool_)


def _numbers(value: Any, name: str, shape: tuple[int, ...], expected: str) -> Any:
    given = getattr(value, name, None)
    if given is None:
        return None
    array = _array(given, name)
    if array.shape != shape or array.dtype.kind not in "fiub":
        raise InvalidEstimateError(
            f"{name} is {array.dtype} {list(array.shape)}, expected real numbers {expected}"
        )
    return array.astype(np.float64)


def _array(value: Any, name: str) -> NDArray[Any]:
    try:
        return np.asarray(value)
    except Exception as error:  # a foreign class may raise anything
        raise InvalidEstimateError(f"{name} is not an array ({error})") from error


def dump_stored(stored: Stored) -> bytes:
    """Return the ZIP; equal contents are equal bytes."""
    out = io.BytesIO()
    archive = ArchiveWriter(out)
    tree = {
        "format": _FORMAT,
        "status": stored.status,
        "reason": stored.reason[-MAX_REASON:].encode(errors="backslashreplace").decode(),
        "seconds": stored.seconds,
        "peak_memory": stored.peak_memory,
    }
    archive.add(_JSON, dump_json(tree))
    if stored.estimate is not None:
        fields = ("displacement", "screw", "part", "sigma", "reliable")
        arrays = {name: getattr(stored.estimate, name) for name in fields}
        data = io.BytesIO()
        np.savez_compressed(data, **{k: v for k, v in arrays.items() if v is not None})
        archive.add(_ARRAYS, data.getvalue())
    archive.close()
    return out.getvalue()


def read_stored(path: Path, shape: EstimateShape) -> Stored:
    """Read the estimate in a file. Raises DatasetError with what is wrong with it."""
    archive = open_archive(path)
    where = archive.where(_JSON)
    tree = parse_json(archive.read(_JSON, 2**20), where, _FORMAT, former=_FORMER)
    tree.pop("estimate", None)
    stored = to_record(tree, Stored, where)
    estimate = None
    if stored.status == "ok":
        estimate = _parse_arrays(archive.read(_ARRAYS, _MAX_BYTES), shape, archive.where(_ARRAYS))
    return replace(stored, reason=stored.reason[-MAX_REASON:], estimate=estimate)


def _parse_arrays(data: bytes, shape: EstimateShape, where: str) -> Estimate:
    """Parse an NPZ that inflates to no more than an estimate of this shape needs."""
    t, j = shape.frames, shape.joints
    specs = {
        "displacement": ArraySpec((t, j)),
        "screw": ArraySpec((j, 6)),
        "part": ArraySpec((t, shape.height, shape.width), "biu"),
        "sigma": ArraySpec((t, j)),
        "reliable": ArraySpec((j,), "b"),
    }
    arrays = parse_npz(data, specs, where, only_known=True)
    if "displacement" not in arrays:
        raise DatasetError(f"{where}: no displacement")
    try:
        return validate_estimate(Estimate(**arrays), shape)
    except InvalidEstimateError as error:
        raise DatasetError(f"{where}: {error}") from error
