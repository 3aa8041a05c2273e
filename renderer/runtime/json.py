"""JSON and TOML at the border: bytes become plain trees, and trees become typed records.

A record is a dataclass whose annotations state types and bounds:

    @dataclass(frozen=True)
    class Size:
        width: Annotated[int, msgspec.Meta(ge=1, le=4096)]

    read_record(path, Size)  # DatasetError: "size.json: $.width: expected int >= 1, got 0"

Untrusted bytes end in a record or in an error of one line that names the file and the field: NaN,
infinity, numbers out of range, deep nesting, dates and wrong types are refused.
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from ...errors import ConfigError, DatasetError, GcbenchError
from .object_store import address, read_file

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pyright: ignore[reportMissingImports]

MAX_JSON = 2**25
"""Bytes of a JSON or TOML file; a larger one is refused."""
Record = TypeVar("Record")
_MAX_LEVELS = 64  # of nesting, so that code which follows a tree by recursion is safe
_MAX_BITS = 128  # of an integer: a seed may have that many
_SHOWN = 60  # characters of a wrong value in a message


def dump_json(tree: Any) -> bytes:
    """Return indented JSON of dicts, lists, tuples, numbers, strings and NumPy values.

    Raises ValueError for NaN and infinity, which JSON cannot express.
    """
    def plain(value: Any) -> Any:
        if isinstance(value, np.generic | np.ndarray):
            return value.tolist()
        if isinstance(value, Mapping):
            return dict(cast("Mapping[str, Any]", value))
        raise TypeError(f"JSON cannot express {type(value).__name__}")

    return (json.dumps(tree, indent=1, allow_nan=False, default=plain) + "\n").encode()


def parse_json(
    data: bytes, where: str, file_format: str = "", error: type[GcbenchError] = DatasetError,
    former: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Return the JSON object in `data`, whose field `format` is `file_format` (empty: any) or one
    of the `former` formats.

    Anything else is an `error`, whose message begins with `where`: the file, and its member.
    """
    try:
        tree = msgspec.json.decode(data)
        _check_tree(tree)
    except (msgspec.MsgspecError, ValueError, RecursionError) as problem:
        raise error(f"{where}: not JSON ({_one_line(problem)})") from problem
    if not isinstance(tree, dict):
        raise error(f"{where}: not a JSON object")
    found = cast("dict[str, Any]", tree)
    if file_format and found.get("format") not in (file_format, *former):
        raise error(
            f"{where}: format is {_short(found.get('format'))}; "
            f"this version reads {file_format!r}"
        )
    return found


def parse_toml(data: bytes, where: str) -> dict[str, Any]:
    """Return the table in `data`; `where` begins the ConfigError of anything else."""

    def finite(text: str) -> float:
        if not np.isfinite(value := float(text)):
            raise ValueError(f"{_short(text)} is not a finite number")
        return value

    try:
        tree = tomllib.loads(data.decode(), parse_float=finite)
        _check_tree(tree)
        return tree
    except (ValueError, RecursionError) as problem:
        raise ConfigError(f"{where}: not TOML ({_one_line(problem)})") from problem


def _check_tree(tree: Any) -> None:
    """Raise ValueError for deep nesting, huge integers and dates, which later code cannot handle.
    """
    level = [tree]
    for _ in range(_MAX_LEVELS + 1):
        below: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                below += cast("dict[str, Any]", value).values()
            elif isinstance(value, list):
                below += cast("list[Any]", value)
            elif isinstance(value, int) and value.bit_length() > _MAX_BITS:
                raise ValueError(f"an integer of more than {_MAX_BITS} bits")
            elif isinstance(value, datetime.date | datetime.time):
                raise ValueError(f"{value} is a date or time; write it in quotes")
        level = below
        if not level:
            return
    raise ValueError(f"more than {_MAX_LEVELS} levels of nesting")


def to_record(
    tree: Any,
    kind: type[Record],
    where: str,
    only_known: bool = False,
    error: type[GcbenchError] = DatasetError,
) -> Record:
    """Return the record of type `kind` (a dataclass) in a tree of `parse_json` or `parse_toml`.

    Fields that the record lacks are ignored, or refused with `only_known`. `where` and `error` as
    in `parse_json`.
    """
    if only_known:
        for path, known in _unknown_fields(kind, tree, "$"):
            raise error(f"{where}: {path}: unknown field; there are {', '.join(known)}")
    try:
        return msgspec.convert(tree, kind)
    except (msgspec.ValidationError, RecursionError) as problem:
        raise error(f"{where}: {_explain(str(problem), tree, kind)}") from problem


def read_record(
    path: Path, kind: type[Record], file_format: str = "", only_known: bool = False
) -> Record:
    """Return the record in a JSON file, or raise DatasetError; see `parse_json`, `to_record`."""
    tree = parse_json(read_file(path, MAX_JSON), address(path), file_format)
    if only_known:
        tree.pop("format", None)
    return to_record(tree, kind, address(path), only_known)


def _unknown_fields(kind: Any, tree: Any, path: str) -> Iterator[tuple[str, list[str]]]:
    """Path of each field that the dataclass lacks, and the fields that it has."""
    if not dataclasses.is_dataclass(kind) or not isinstance(tree, dict):
        return
    hints = _annotations(kind)
    for name, value in cast("dict[str, Any]", tree).items():
        if name not in hints:
            yield f"{path}.{_short(name)[1:-1]}", list(hints)
        else:
            yield from _unknown_fields(hints[name], value, f"{path}.{name}")


_annotations = cache(get_type_hints)


def _explain(message: str, tree: Any, kind: Any) -> str:
    """msgspec's message with the path first and the wrong value last."""
    text, _, path = message.replace("`", "").partition(" - at ")
    path = path or "$"
    text = text[0].lower() + text[1:]
    if missing := re.fullmatch(r"object missing required field (\w+)", text):
        return f"{path}.{missing[1]}: missing"
    if "..." in path:  # a value of a mapping, whose key msgspec does not name
        return f"{path}: {text}"
    value, kind = tree, _plain(kind)
    for name, index in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        value = value[name] if name else value[int(index)]
        kind = _plain(_inner(kind, name, index))
    if text.startswith("invalid enum value"):
        text = f"expected one of {', '.join(map(str, get_args(kind)))}"
    if "length" not in text:
        text = re.sub(r", got \w+$", "", text) + f", got {_short(value)}"
    return f"{path}: {text}"


def _inner(kind: Any, name: str, index: str) -> Any:
    """The annotation of a field, or of an item of a sequence."""
    if name:
        return get_type_hints(kind, include_extras=True)[name]
    items = get_args(kind)
    return items[0] if Ellipsis in items else items[min(int(index), len(items) - 1)]


def _plain(kind: Any) -> Any:
    """The annotation without its bounds, and without None."""
    choices = [k for k in get_args(kind) if k is not type(None)]
    if get_origin(kind) is Annotated or type(None) in get_args(kind):
        return _plain(choices[0])
    return kind


def _short(value: Any) -> str:
    try:
        text = ascii(value)
    except ValueError:  # an integer of more digits than Python prints
        text = "a huge integer"
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def _one_line(problem: Exception) -> str:
    return " ".join(str(problem).split())[:200]
