"""`meta.json`: a sequence's facts as bytes, and back, checked; and the JSON of all our files."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, cast

from ...errors import GcbenchError
from ..runtime import dump_json, parse_json
from ..scene import LAYERS
from ..types import FORMAT, Meta
from .codec import MAX_PIXELS

MAX_FRAMES = 1_000_000
UNITS = {
    "length": "m",
    "angle": "rad",
    "time": "s",
    "flow": "px",
}
JOINT_TYPES = ("revolute", "continuous", "prismatic")


def dump_meta(meta: Meta) -> bytes:
    """The bytes of `meta.json`."""
    tree = {field.name: getattr(meta, field.name) for field in dataclasses.fields(meta)}
    tree["units"] = dict(meta.units or UNITS)
    return dump_json({"format": tree.pop("format"), **tree})


def parse_meta(data: bytes, where: str) -> Meta:
    """Meta from the bytes of `meta.json`; keys that this version does not know are ignored.

    Raises GcbenchError, beginning with `where`, if a value is missing or not what it must be.
    """
    tree = parse_json(data, where)
    if tree.get("format") != FORMAT:
        raise GcbenchError(f"{where}: format {tree.get('format')!r}, this version reads {FORMAT!r}")
    for key, (fits, expected) in _META.items():
        if key in _LATER:
            tree.setdefault(key, _LATER[key])
        if key not in tree:
            raise GcbenchError(f"{where}: no {key!r}")
        if not fits(tree[key]):
            raise GcbenchError(f"{where}: {key} is {_short(tree[key])}, expected {expected}")
    values: dict[str, Any] = {
        key: _frozen(tree[key]) if key in _TUPLES else tree[key] for key in _META
    }
    meta = Meta(**values, format=FORMAT)
    joints = len(meta.joint_names)
    if not len(meta.joint_types) == len(meta.joint_limits) == joints:
        raise GcbenchError(f"{where}: joint names, types and limits differ in number")
    if unknown := set(meta.scored_joints) - set(meta.joint_names):
        raise GcbenchError(f"{where}: scored joint {min(unknown)!r} is not in joint_names")
    if unknown := set(meta.deforming_parts) - set(meta.part_names):
        raise GcbenchError(f"{where}: deforming part {min(unknown)!r} is not in part_names")
    if meta.width * meta.height > MAX_PIXELS:
        raise GcbenchError(f"{where}: {meta.width}x{meta.height} px are more than {MAX_PIXELS}")
    return meta


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_int(low: int, high: float = math.inf) -> Callable[[Any], bool]:
    return lambda v: isinstance(v, int) and not isinstance(v, bool) and low <= v <= high


def _is_object(value: Any) -> bool:
    return isinstance(value, dict)


def _is_list(of: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda v: isinstance(v, list) and all(of(x) for x in cast("list[Any]", v))


def _is_limit(value: Any) -> bool:
    return value is None or (_is_list(_is_number)(value) and len(value) == 2)


_META: dict[str, tuple[Callable[[Any], bool], str]] = {
    "name": (_is_text, "a string"),
    "asset": (_is_object, "an object"),
    "joint_names": (_is_list(_is_text), "a list of strings"),
    "joint_types": (_is_list(lambda v: v in JOINT_TYPES), f"a list of {', '.join(JOINT_TYPES)}"),
    "joint_limits": (_is_list(_is_limit), "a list of [low, high] or null"),
    "part_names": (_is_list(_is_text), "a list of strings"),
    "scored_joints": (_is_list(_is_text), "a list of strings"),
    "width": (_is_int(1, MAX_PIXELS), "a positive integer"),
    "height": (_is_int(1, MAX_PIXELS), "a positive integer"),
    "frames": (_is_int(1, MAX_FRAMES), f"an integer in 1..{MAX_FRAMES}"),
    "seed": (_is_int(0), "an integer from 0"),
    "index": (_is_int(0), "an integer from 0"),
    "randomization": (_is_object, "an object"),
    "renderer": (_is_object, "an object"),
    "observability": (_is_object, "an object"),
    "depth_unit": (lambda v: _is_number(v) and 1e-9 <= v <= 1e3, "m per unit, 1e-9 to 1000"),
    "camera_model": (lambda v: v == "pinhole", "'pinhole'"),
    "units": (_is_object, "an object"),
    "deforming_parts": (_is_list(_is_text), "a list of strings"),
    "layers": (_is_list(lambda v: v in LAYERS), f"a list of {', '.join(LAYERS)}"),
    "keypoint_names": (_is_list(_is_text), "a list of strings"),
    "keypoint_tolerance": (lambda v: _is_number(v) and v >= 0, "m, from 0"),
    "tracks": (_is_int(0, MAX_FRAMES), f"an integer in 0..{MAX_FRAMES}"),
}
_LATER: dict[str, Any] = {"deforming_parts": [], "layers": [], "keypoint_names": [],
                          "keypoint_tolerance": 0.0, "tracks": 0}
"""What the first datasets do not say, and what that means."""
_TUPLES = ("joint_names", "joint_types", "joint_limits", "part_names", "scored_joints",
           "deforming_parts", "layers", "keypoint_names")


def _frozen(values: list[Any]) -> tuple[Any, ...]:
    return tuple(tuple(cast("list[Any]", v)) if isinstance(v, list) else v for v in values)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
