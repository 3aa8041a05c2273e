"""A configuration as JSON or TOML, and back: what decides every sequence of a dataset."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, cast, get_args, get_origin, get_type_hints

from ...errors import GcbenchError
from ..runtime import MAX_JSON, dump_json, parse_json
from .config import RenderConfig

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pyright: ignore[reportMissingImports]

T = TypeVar("T")


def config_tree(config: RenderConfig) -> dict[str, Any]:
    """The config as JSON gives it back: dicts, lists, numbers and strings."""
    return json.loads(dump_json(dataclasses.asdict(config)))


def parse_config(
    tree: Mapping[str, Any], where: str, base: RenderConfig | None = None
) -> RenderConfig:
    """The config in a tree; a field that is not there has its value in `base` (the defaults).

    Raises GcbenchError, beginning with `where`, for an unknown field or a value of another type.
    """
    return _overlay(base or RenderConfig(), tree, where)


def read_config(path: Path, base: RenderConfig | None = None) -> RenderConfig:
    """The config in a TOML or JSON file, or the one in a `dataset.json`.

    Raises GcbenchError if the file cannot be read or has a field or value that is none.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_JSON)
        tree = _parse_toml(data) if path.suffix == ".toml" else parse_json(data, str(path))
    except OSError as error:
        raise GcbenchError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise GcbenchError(f"{path}: not TOML ({error})") from error
    if "format" in tree and isinstance(tree.get("config"), dict):
        tree = tree["config"]
    return parse_config(tree, str(path), base)


def _parse_toml(data: bytes) -> dict[str, Any]:
    return tomllib.loads(data.decode())


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """ "field: old -> new" of each leaf of two trees that differs."""
    a, b = _leaves(old), _leaves(new)
    return [
        f"{key}: {_show(a, key)} -> {_show(b, key)}"
        for key in [*a, *(k for k in b if k not in a)]
        if (key in a, a.get(key)) != (key in b, b.get(key))
    ]


def _show(leaves: dict[str, Any], key: str) -> str:
    return json.dumps(leaves[key]) if key in leaves else "nothing"


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            leaves |= _leaves(cast("dict[str, Any]", value), f"{prefix}{key}.")
        else:
            leaves[f"{prefix}{key}"] = value
    return leaves


def _overlay(base: T, tree: Mapping[str, Any], where: str) -> T:
    """The dataclass `base` with the fields that `tree` has."""
    hints = get_type_hints(type(base))
    changes: dict[str, Any] = {}
    for name, value in tree.items():
        if name not in hints:
            known = ", ".join(hints)
            raise GcbenchError(f"{where}: unknown field {name!r}; there are {known}")
        old = getattr(base, name)
        if not dataclasses.is_dataclass(old):
            changes[name] = _parse(hints[name], value, f"{where}: {name}")
        elif isinstance(value, dict):
            changes[name] = _overlay(old, cast("dict[str, Any]", value), f"{where}: {name}")
        else:
            raise GcbenchError(f"{where}: {name} is {value!r}, expected fields")
    return dataclasses.replace(cast("Any", base), **changes)


def _parse(kind: Any, value: Any, where: str) -> Any:
    """`value` as a tuple, Literal, number or string, as the annotation `kind` says."""
    arguments = get_args(kind)
    if get_origin(kind) is Literal and any(
        value == a and type(value) is type(a) for a in arguments
    ):
        return value
    if get_origin(kind) is tuple and isinstance(value, list):
        items = cast("list[Any]", value)
        kinds = [arguments[0]] * len(items) if arguments[-1] is Ellipsis else list(arguments)
        if len(kinds) == len(items):
            return tuple(_parse(k, v, where) for k, v in zip(kinds, items, strict=True))
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if kind in (int, bool, str) and type(value) is kind:
        return value
    raise GcbenchError(f"{where} is {value!r}, which is not a value for it")
