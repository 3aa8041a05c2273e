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
Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Scales = Annotated[tuple[Positive, ...], Meta(min_length=1)]

S = TypeVar("S", bound="SettingsRecord")


class SettingsRecord:
    """Base of the settings that a method takes as its argument `settings`."""

    def as_dict(self) -> dict[str, Any]:
        """Return all settings as a tree of JSON values."""
        return msgspec.to_builtins(self)

    def override(self: S, changes: Mapping[str, str]) -> S:
        """Return a copy with some settings replaced.

        Args:
            changes: Text by dotted name, such as `{"rgb.max_points": "200"}`; the numbers of a
                tuple are separated by commas.

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


def _replaced(settings: S, name: str, text: str) -> S:
    tree = settings.as_dict()
    *path, last = name.split(".")
    at, record, known = tree, settings, ""
    for key in path:
        inner = getattr(record, key, None) if key in at else None
        if not is_dataclass(inner):
            break
        at, record, known = at[key], cast("Any", inner), f"{known}{key}."
    if known + last != name or last not in at or isinstance(at[last], dict):
        there = ", ".join(known + leaf for leaf, _ in _leaves(record))
        raise ConfigError(f"no setting {name!r}; there are {there}")
    at[last] = text.split(",") if isinstance(at[last], list | tuple) else text
    try:
        out = msgspec.convert(tree, type(settings), strict=False)
    except msgspec.ValidationError as error:
        reason = str(error).partition(" - at")[0].replace("`", "").replace(", got str", "")
        raise ConfigError(f"setting {name}={text}: {reason[0].lower()}{reason[1:]}") from error
    value: Any = dict(_leaves(out))[name]
    if not all(map(math.isfinite, value if isinstance(value, tuple) else (value,))):
        raise ConfigError(f"setting {name}={text}: expected a finite number")
    return out


def _leaves(record: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names and values of all numbers of a record."""
    for field in fields(record):
        value = getattr(record, field.name)
        if is_dataclass(value):
            yield from _leaves(value, f"{prefix}{field.name}.")
        else:
            yield prefix + field.name, value


def _text(value: Any) -> str:
    return ",".join(map(_text, value)) if isinstance(value, tuple) else f"{value:.9g}"
