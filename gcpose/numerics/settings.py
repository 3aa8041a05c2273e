"""Settings records: frozen dataclasses of tuned numbers that can be listed, overridden and stored.

A record holds numbers, tuples of numbers, and further records. Its annotations carry the bounds;
the string below a field gives its unit and effect.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, TypeVar, cast

import msgspec
from msgspec import Meta

from ...errors import ConfigError

DEGREE = math.pi / 180
"""rad"""
Count = Annotated[int, Meta(ge=1)]
Whole = Annotated[int, Meta(ge=0)]
Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Scales = Annotated[tuple[Positive, ...], Meta(min_length=1)]

_Record = TypeVar("_Record", bound="SettingsRecord")


class SettingsRecord:
    """Base of the settings that a method takes as its argument `settings`."""

    def as_dict(self) -> dict[str, Any]:
        """Return all settings as a tree of JSON values."""
        return msgspec.json.decode(msgspec.json.encode(self))

    def override(self: _Record, changes: Mapping[str, str]) -> _Record:
        """Return a copy with some settings replaced.

        Args:
            changes: Text by dotted name, such as `{"rgb.max_points": "200"}`. Commas separate
                the numbers of a tuple, semicolons the tuples of a tuple.

        Raises:
            ConfigError: If a setting does not exist, or a value has the wrong type or is out of
                bounds.
        """
        out = self
        for name, text in changes.items():
            out = _replaced(out, name, text)
        return out

    def changes(self) -> dict[str, str]:
        """Return the settings that differ from the defaults, as `override` takes them."""
        default = dict(_leaves(type(self)()))
        return {name: _text(value) for name, value in _leaves(self) if value != default[name]}


def _replaced(settings: _Record, name: str, text: str) -> _Record:
    tree = settings.as_dict()
    leaves = dict(_leaves(settings))
    if name not in leaves:
        parts = name.split(".")
        heads = [".".join(parts[:n]) + "." for n in range(len(parts), 0, -1)]
        near = next(([n for n in leaves if n.startswith(h)] for h in heads
                     if any(n.startswith(h) for n in leaves)), leaves)
        raise ConfigError(f"no setting {name!r}; there are {', '.join(near)}")
    *path, last = name.split(".")
    at: Any = tree
    for key in path:
        at = at[int(key) if isinstance(at, list) else key]
    at[last] = _parse(text, leaves[name])
    try:
        out = msgspec.convert(tree, type(settings), strict=False)
    except msgspec.ValidationError as error:
        reason = str(error).partition(" - at")[0].replace("`", "").replace(", got str", "")
        raise ConfigError(f"setting {name}={text}: {reason[0].lower()}{reason[1:]}") from error
    if not all(map(math.isfinite, _numbers(dict(_leaves(out))[name]))):
        raise ConfigError(f"setting {name}={text}: expected a finite number")
    return out


def _leaves(record: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted names and values of all numbers and tuples of a record."""
    for f in fields(record):
        value = getattr(record, f.name)
        inner = dict(enumerate(cast("tuple[Any, ...]", value))) if isinstance(value, tuple) else {}
        if is_dataclass(value):
            yield from _leaves(value, f"{prefix}{f.name}.")
        elif any(is_dataclass(v) for v in inner.values()):
            for k, v in inner.items():
                yield from _leaves(v, f"{prefix}{f.name}.{k}.")
        else:
            yield prefix + f.name, value


def _parse(text: str, old: Any) -> Any:
    if not isinstance(old, tuple):
        return text
    if any(isinstance(v, tuple) for v in cast("tuple[Any, ...]", old)):
        return [_parse(part, (0,)) for part in text.split(";")]
    return text.split(",")


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, tuple):
        for v in cast("tuple[Any, ...]", value):
            yield from _numbers(v)
    else:
        yield value


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        values = cast("tuple[Any, ...]", value)
        deep = any(isinstance(v, tuple) for v in values)
        return (";" if deep else ",").join(map(_text, values))
    return str(value).lower() if isinstance(value, bool) else f"{value:.9g}"
