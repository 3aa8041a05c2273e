"""Settings records: frozen dataclasses of tuned numbers that can be listed, overridden and stored.

A record holds numbers, tuples of numbers, and further records. Its annotations carry the bounds;
a comment behind a field, or the string below it, gives its unit and effect.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, TypeVar

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
                the numbers of a tuple.

        Raises:
            ConfigError: If a setting does not exist, or a value has the wrong type or is out of
                bounds.
        """
        out = self
        for name, text in changes.items():
            out = _replace(out, name, text)
        return out

    def changes(self) -> dict[str, str]:
        """Return the settings that differ from the defaults, as `override` takes them."""
        default = dict(_leaves(type(self)().as_dict()))
        return {name: _text(value) for name, value in _leaves(self.as_dict())
                if value != default[name]}


def _replace(settings: _Record, name: str, text: str) -> _Record:
    tree = settings.as_dict()
    leaves, parts = dict(_leaves(tree)), name.split(".")
    if name not in leaves:
        heads = [".".join(parts[:n]) + "." for n in range(len(parts), 0, -1)]
        listed = ([n for n in leaves if n.startswith(head)] for head in heads)
        raise ConfigError(
            f"no setting {name!r}; there are {', '.join(next(filter(None, listed), leaves))}")
    at: Any = tree
    for key in parts[:-1]:
        at = at[int(key) if isinstance(at, list) else key]
    at[parts[-1]] = text.split(",") if isinstance(leaves[name], list) else text
    try:
        out = msgspec.convert(tree, type(settings), strict=False)
    except msgspec.ValidationError as error:
        reason = str(error).partition(" - at")[0].replace("`", "").replace(", got str", "")
        raise ConfigError(f"setting {name}={text}: {reason[0].lower()}{reason[1:]}") from error
    if b"null" in msgspec.json.encode(out):  # JSON has neither infinity nor NaN
        raise ConfigError(f"setting {name}={text}: expected a finite number")
    return out


def _leaves(tree: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted names and values of all numbers and lists of numbers of a tree."""
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        if isinstance(value, dict) or (isinstance(value, list) and value
                                       and isinstance(value[0], dict)):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ",".join(map(_text, value))
    return str(value).lower() if isinstance(value, bool) else f"{value:.9g}"
