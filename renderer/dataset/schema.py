"""`meta.json`: a sequence's facts as bytes, and back, checked."""

from __future__ import annotations

from ...errors import DatasetError
from ..runtime import dump_json, parse_json, to_record
from ..types import FORMAT, MAX_PIXELS, Meta

UNITS = {"length": "m", "angle": "rad", "time": "s", "flow": "px"}
MAX_META = 2**24
"""Bytes of a `meta.json`; a larger one is refused."""
_REQUIRED = ("depth_unit", "camera_model", "units")
"""Fields with defaults in `Meta` that every file states."""


def dump_meta(meta: Meta) -> bytes:
    """Return the bytes of `meta.json`."""
    tree = {**vars(meta), "units": dict(meta.units or UNITS)}
    if not meta.omitted:
        del tree["omitted"]
    return dump_json({"format": tree.pop("format"), **tree})


def parse_meta(data: bytes, where: str) -> Meta:
    """Return the meta in the bytes of `meta.json`; unknown keys are ignored.

    Raises:
        DatasetError: beginning with `where`, if a value is missing, of another type or out of
            bounds, or if two values contradict each other.
    """
    tree = parse_json(data, where, FORMAT)
    for key in _REQUIRED:
        if key not in tree:
            raise DatasetError(f"{where}: $.{key}: missing")
    meta = to_record(tree, Meta, where)
    joints = len(meta.joint_names)
    if not len(meta.joint_types) == len(meta.joint_limits) == joints:
        raise DatasetError(f"{where}: joint names, types and limits differ in number")
    if unknown := set(meta.scored_joints) - set(meta.joint_names):
        raise DatasetError(f"{where}: scored joint {min(unknown)!r} is not in joint_names")
    if unknown := set(meta.deforming_parts) - set(meta.part_names):
        raise DatasetError(f"{where}: deforming part {min(unknown)!r} is not in part_names")
    if meta.width * meta.height > MAX_PIXELS:
        raise DatasetError(f"{where}: {meta.width}x{meta.height} px are more than {MAX_PIXELS}")
    return meta
