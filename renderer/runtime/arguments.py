"""Options that Python code gives: fields of the types that their annotations state, or an error."""

from __future__ import annotations

import types
from dataclasses import is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeAlias,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from ...errors import ConfigError

if TYPE_CHECKING:
    AnyPath: TypeAlias = str | Path
else:
    AnyPath = Path  # what the command line reads, and `convert_fields` makes of a text

_Config = TypeVar("_Config")
_WORDS = {int: "a whole number", float: "a number", str: "a text", bool: "True or False",
          Path: "a path, as text or Path"}
_SHOWN = 60  # characters of a wrong value in a message


def convert_fields(config: _Config, kind: type[_Config]) -> _Config:
    """Return a dataclass of some kind whose fields, and those of dataclasses in it, have the types
    of their annotations.

    Lists become tuples, texts become paths, and NumPy's numbers those of Python. Raises ConfigError
    with the name of a field that has a value of another type.
    """
    return _convert_record(config, kind, kind.__name__)


def refuse_lone_values(values: object, name: str) -> None:
    """Raise ConfigError for one text or path in the place of a sequence of them.

    Its letters would be taken for the values.
    """
    if isinstance(values, str | Path):
        raise ConfigError(f"{name}: write a tuple, {name.rpartition('.')[2]}=({_short(values)},)")


@cache
def field_types(kind: type) -> dict[str, Any]:
    """Return the annotations of a dataclass, which take a millisecond to read."""
    return get_type_hints(kind, include_extras=True)


def _convert_record(config: Any, kind: type, where: str) -> Any:
    if not is_dataclass(kind) or not isinstance(config, kind):
        raise _wrong(where, f"a {kind.__name__}", config)
    changes: dict[str, Any] = {}
    for name, hint in field_types(type(config)).items():
        old = getattr(config, name)
        new = _convert(old, hint, f"{where}.{name}")
        if new is not old:
            changes[name] = new
    return replace(cast("Any", config), **changes) if changes else config


def _convert(value: Any, hint: Any, where: str) -> Any:
    """The value as one of type `hint`, or ConfigError that begins with `where`."""
    origin, choices = get_origin(hint), get_args(hint)
    if isinstance(value, np.generic):
        value = value.item()
    if origin is Annotated:
        return _convert(value, choices[0], where)
    if origin in (types.UnionType, Union):
        return _convert_union(value, choices, where)
    if origin is Literal:
        if any(value == c and type(value) is type(c) for c in choices):
            return value
        raise _wrong(where, f"one of {', '.join(map(str, choices))}", value)
    if origin is tuple:
        return _convert_tuple(value, choices, where)
    if is_dataclass(hint):
        return _convert_record(value, cast("type", hint), where)
    kinds = int | float if hint is float else hint
    if isinstance(value, kinds) and (hint is bool or not isinstance(value, bool)):
        return value
    if hint is Path and isinstance(value, str):
        return Path(value)
    raise _wrong(where, _WORDS[hint], value)


def _convert_union(value: Any, choices: tuple[Any, ...], where: str) -> Any:
    if value is None and type(None) in choices:
        return None
    kinds = [c for c in choices if c is not type(None)]
    if len(kinds) == 1:
        return _convert(value, kinds[0], where)
    for kind in kinds:  # literals of several types
        try:
            return _convert(value, kind, where)
        except ConfigError:
            continue
    known = [str(name) for kind in kinds for name in get_args(kind)]
    raise _wrong(where, f"one of {', '.join(known)}", value)


def _convert_tuple(value: Any, kinds: tuple[Any, ...], where: str) -> tuple[Any, ...]:
    several = len(kinds) == 2 and kinds[1] is Ellipsis
    if several:
        refuse_lone_values(value, where)
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        raise _wrong(where, "a tuple", value)
    items = cast("tuple[Any, ...]", value)
    if not several and len(items) != len(kinds):
        raise _wrong(where, f"{len(kinds)} values", value)
    found = tuple(_convert(item, kinds[0] if several else kind, f"{where}[{k}]")
                  for k, (item, kind) in enumerate(zip(items, kinds * len(items) if several
                                                       else kinds, strict=False)))
    same = isinstance(value, tuple) and all(a is b for a, b in zip(found, items, strict=True))
    return cast("tuple[Any, ...]", value) if same else found


def _wrong(where: str, expected: str, value: object) -> ConfigError:
    return ConfigError(f"{where}: expected {expected}, got {_short(value)}")


def _short(value: object) -> str:
    text = ascii(str(value) if isinstance(value, Path) else value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN - 3]}..."
