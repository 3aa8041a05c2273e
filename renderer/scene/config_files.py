"""A configuration as JSON or TOML, and back: what decides every sequence of a dataset."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any, TypeVar, cast

from ...errors import ConfigError, GcbenchError
from ...robots.files import read_bounded
from ..runtime import MAX_JSON, dump_json, parse_json, parse_toml, to_record
from .config import RenderConfig, find_invalid_values

Config = TypeVar("Config")
_ADDED = (
    "flow", "visibility", "randomization.image.exposure_drift", "randomization.camera.shake_turn",
    "randomization.camera.shake_shift",
)


def config_tree(config: RenderConfig) -> dict[str, Any]:
    """Return the config as JSON gives it back: dicts, lists, numbers and strings.

    Fields that earlier versions did not store are left out where they have their defaults, so that
    trees of the same data are equal.
    """
    tree, usual = (json.loads(dump_json(dataclasses.asdict(c))) for c in (config, RenderConfig()))
    for name in _ADDED:
        *groups, field = name.split(".")
        here, there = (reduce(getitem, groups, t) for t in (tree, usual))
        if here[field] == there[field]:
            del here[field]
    return tree


def parse_config(
    tree: Mapping[str, Any],
    where: str,
    base: RenderConfig | None = None,
    error: type[GcbenchError] = ConfigError,
) -> RenderConfig:
    """Return the config in a tree of fields; an absent field has its value in `base`.

    Without a base, an absent `twin_of` is "", because earlier versions did not store it. An unknown
    field or an invalid value is an `error`, whose message begins with `where`.
    """
    found = to_record(tree, RenderConfig, where, only_known=True, error=error)
    config = _overlay(base or RenderConfig(twin_of=""), found, tree)
    for field, problem in find_invalid_values(config):
        raise error(f"{where}: $.{field}: {problem}")
    return config


def read_config(path: Path, base: RenderConfig | None = None) -> RenderConfig:
    """Return the config in a TOML or JSON file, or in a `dataset.json`; see `parse_config`."""
    data = read_bounded(path, MAX_JSON, ConfigError)
    if path.suffix.lower() == ".toml":
        tree = parse_toml(data, str(path))
    elif path.suffix.lower() == ".json":
        tree = parse_json(data, str(path), error=ConfigError)
    else:
        raise ConfigError(f"{path}: a configuration file is named .toml or .json")
    if "format" in tree and isinstance(tree.get("config"), dict):
        tree = tree["config"]
    return parse_config(tree, str(path), dataclasses.replace(base or RenderConfig(), twin_of=""))


def _overlay(base: Config, found: Config, tree: Mapping[str, Any]) -> Config:
    """The dataclass `base` with the fields of `found` that `tree` names."""
    changes: dict[str, Any] = {}
    for name, value in tree.items():
        old, new = getattr(base, name), getattr(found, name)
        changes[name] = _overlay(old, new, value) if dataclasses.is_dataclass(old) else new
    return dataclasses.replace(cast("Any", base), **changes)


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Return "field: old -> new" for each leaf in which two trees differ."""
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
